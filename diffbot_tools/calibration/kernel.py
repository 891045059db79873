"""The compiled filter over the arrays of a drive: what comes when, and the figures of each measurement.

States, models and algebra are of :mod:`diffbot_sim.compiled.ekf`.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from diffbot_control.filter.correlation import inflation_after
from diffbot_control.filter.models import NO_RATE, Motion
from diffbot_control.filter.odometry_noise import MotionDensity, motion_density, over_time
from diffbot_core.geometry import Point, Pose
from diffbot_core.kinematics import Twist, TwistCovariance, scale_twist_covariance
from diffbot_sim.compiled.ekf import (
    FIX_ERRORS,
    GYRO,
    POSE,
    belief_type,
    correct,
    fill_fix,
    fill_heading,
    fill_landmark,
    normalise,
    predict,
    reset_to,
    work_type,
)
from diffbot_tools.calibration.settings import (
    DENSITY,
    INNOVATION,
    LOG_2PI,
    MESSAGE,
    NANO,
    NEVER,
    NIS,
    NUMBERS,
    TERM,
    WEIGHT,
    WHITE,
    Settings,
)

FILTER = np.dtype([("belief", belief_type(FIX_ERRORS)), ("work", work_type(FIX_ERRORS))])
"""Arrays of the filter, which are changed in place."""


def run_filter(odometry: Any, measurements: Any, starts_from_fix: bool, arrays: Any, result: Any, s: Settings) -> None:
    """Filter a drive.

    Args:
        odometry: see :class:`events.Odometry`.
        measurements: see :class:`events.Measurements`; the first is a reset.
        starts_from_fix: its error may be correlated with those of the next fixes.
        arrays: (1,) FILTER; the belief is that before the first reset, and becomes that at the end.
        result: (k, COLUMNS) becomes the figures of each measurement; a reset, or a landmark where the robot stands, has
            zero numbers.
        s: of the filter.
    """
    belief, work = arrays[0]["belief"], arrays[0]["work"]
    last = np.full(len(measurements.time) + 1, NEVER)
    now, index = 0.0, 0
    for k in range(len(measurements.time)):
        time, kind, source = measurements.time[k], measurements.kind[k], measurements.source[k]
        values, R = measurements.values[k], measurements.R[k]
        now, index = advance(belief, work, odometry, now, index, time, s)
        if kind == 3:
            reset_to(belief, Pose(values[0], values[1], values[2]), R)
            if starts_from_fix and k == 0:
                last[source] = time
                if s.fix_bias:
                    start_fix_errors(belief["P"], R)
            continue
        place = Point(measurements.place[k, 0], measurements.place[k, 1])
        m = fill(belief, work, kind, values, R, place, s)
        inflation = 1.0
        if kind == 2 and s.fix_bias:
            gap = time - last[source] if last[source] >= 0.0 else math.inf
            renew_fix_errors(belief, work, math.exp(-gap / s.times[2]))
        elif m > 0 and s.times[kind] > 0.0 and last[source] >= 0.0:
            inflation = inflation_after(time - last[source], s.times[kind])
        last[source] = time
        if m > 0:
            take(belief, work, m, inflation, s.gates[m - 1], result[k])


def fill(belief: Any, work: Any, kind: int, values: Any, R: Any, place: Point, s: Settings) -> int:
    """Fill in a measurement; return its number of numbers, 0 if it is not usable."""
    if kind == 0:
        return fill_heading(belief, work, values[0], R[0, 0] * s.heading_factor**2)
    if kind == 1:
        variances = R[0, 0] * s.range_factor**2, R[1, 1] * s.bearing_factor**2
        return fill_landmark(belief, work, values[0], values[1], variances, place)
    m = fill_fix(belief, work, Pose(values[0], values[1], values[2]))
    for i in range(POSE):
        for j in range(POSE):
            by_row = s.yaw_factor if i == 2 else s.xy_factor
            by_column = s.yaw_factor if j == 2 else s.xy_factor
            work["R"][i, j] = R[i, j] * by_row * by_column
    return m


def take(belief: Any, work: Any, m: int, inflation: float, gate: float, result: Any) -> None:
    """Correct with what was filled in; write the figures to ``result`` (COLUMNS,).

    Beyond the gate the gain is weighed by gate / NIS, and in the likelihood the NIS counts as
    gate (1 + ln(NIS / gate)), whose derivative is this weight.
    """
    nis, root_det = normalise(belief, work, m)
    for i in range(m):
        result[WHITE + i], result[INNOVATION + i] = work["w"][i], work["y"][i]
    beyond = nis > gate
    counted = gate * (1.0 + math.log(nis / gate)) if beyond else nis
    result[NIS], result[NUMBERS], result[WEIGHT] = nis, m, gate / nis if beyond else 1.0
    result[TERM] = -0.5 * (m * LOG_2PI + 2.0 * math.log(root_det) + counted) / inflation
    correct(belief, work, m, inflation, nis / gate if beyond else 1.0)


def start_fix_errors(P: Any, R: Any) -> None:
    """Give the error of the fix that the pose was put at to the states of the fixes' error."""
    for i in range(POSE):
        for j in range(POSE):
            P[GYRO + i, GYRO + j] = R[i, j]
            P[i, GYRO + j] = P[GYRO + j, i] = -R[i, j]


def renew_fix_errors(belief: Any, work: Any, c: float) -> None:
    """Let the error of the fixes decay to ``c`` of itself; R is its variance, and none is left beside it."""
    x, P, y, H, R = belief["x"], belief["P"], work["y"], work["H"], work["R"]
    for i in range(GYRO, FIX_ERRORS):
        x[i] *= c
        for j in range(FIX_ERRORS):
            P[i, j] *= c
        for j in range(FIX_ERRORS):
            P[j, i] *= c
    for i in range(POSE):
        for j in range(POSE):
            P[GYRO + i, GYRO + j] += (1.0 - c * c) * R[i, j]
            R[i, j] = 0.0
        H[i, GYRO + i] = 1.0
        # The innovation was taken without the error; an angle is not wrapped again, since errors are small.
        y[i] -= x[GYRO + i]


def advance(
    belief: Any, work: Any, odometry: Any, now: float, index: int, until: float, s: Settings
) -> tuple[float, int]:
    """Move from ``now`` to ``until`` [s] with the messages from ``index`` on; return both as they are then.

    Message k acts from start + delay to end + delay; the first also before, the last also after.
    """
    last = len(odometry.end) - 1
    while until - now > NANO:
        while index < last and odometry.end[index] + s.delay <= now + NANO:
            index += 1
        end = odometry.end[index] + s.delay
        if index == last or end > until:
            end = until
        if s.split:
            end = min(end, next_stamp(odometry, index, now, end))
        dt = end - now
        twist = Twist(odometry.twist[index, 0], odometry.twist[index, 1])
        row = odometry.covariance[index]
        covariance = scale_twist_covariance(TwistCovariance(row[0], row[1], row[2]), s.odometry_covariance_scale)
        lateral = 0.0
        known = row[0] != 0.0 or row[1] != 0.0 or row[2] != 0.0
        if known and s.noise == MESSAGE:
            covariance = scale_twist_covariance(covariance, (odometry.end[index] - odometry.start[index]) / dt)
        elif known and s.noise == DENSITY:
            covariance, lateral = over_time(MotionDensity(covariance, 0.0), twist.v, dt)
        else:
            covariance, lateral = over_time(motion_density(twist, s), twist.v, dt)  # type: ignore[arg-type]
        predict(belief, work, Motion(twist, dt, covariance, NO_RATE), lateral, s.separation, s.walk, 0.0)
        now = end
    return now, index


def next_stamp(odometry: Any, index: int, now: float, end: float) -> float:
    """Return the first stamp after ``now`` of the messages from ``index`` on, or ``end`` if there is none before."""
    for later in range(index, len(odometry.end)):
        if odometry.end[later] > now + NANO:
            return min(float(odometry.end[later]), end)
    return end


CALLED = (fill, take, advance, next_stamp, start_fix_errors, renew_fix_errors)
"""Functions that :func:`run_filter` calls."""
