"""The compiled filter over the arrays of a drive: what comes when, and the figures of each measurement.

States, models and algebra are of :mod:`diffbot_sim.compiled.ekf`.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from diffbot_control.filter.correlation import MIN_DT, inflation_after
from diffbot_control.filter.models import NO_RATE, Motion, TurnRate, slip_covariance
from diffbot_control.filter.odometry_noise import MotionDensity, motion_density, over_time
from diffbot_core.geometry import Point, Pose
from diffbot_core.kinematics import Twist, TwistCovariance, add_twist_covariance, scale_twist_covariance
from diffbot_sim.compiled.ekf import (
    POSE,
    WHEELS,
    belief_type,
    correct,
    fill_fix,
    fill_heading,
    fill_landmark,
    fill_rate,
    normalise,
    predict,
    reset_to,
    work_type,
)
from diffbot_tools.calibration.events import UNKNOWN_RATE, Events, Odometry, Rates
from diffbot_tools.calibration.settings import (
    COLUMNS,
    DENSITY,
    INNOVATION,
    LOG_2PI,
    MESSAGE,
    NANO,
    NIS,
    NUMBERS,
    RATES,
    TERM,
    WEIGHT,
    WHITE,
    Settings,
)


def filter_type(n: int) -> Any:
    """Return the type of the filter's arrays for ``n`` states; after the bias of the gyro, errors of sources.

    Held is the turn rate of the present odometry message, by its index: value, variance times the message's duration,
    and the difference from the wheels times the root of that duration, where it is a contradiction; else 0.
    """
    held = np.dtype([("index", np.int64), ("value", float), ("variance", float), ("slip", float)])
    return np.dtype([("belief", belief_type(n)), ("work", work_type(n)), ("held", held)])


def run_filter(events: Events, arrays: Any, result: Any, s: Settings) -> None:
    """Filter a drive.

    Args:
        events: of the drive; the first measurement is a reset.
        arrays: (1,) :func:`filter_type`; the belief is that before the first reset, and becomes that at the end.
        result: (k, COLUMNS) becomes the figures of each measurement; a reset, or a landmark where the robot stands, has
            zero numbers.
        s: of the filter.
    """
    belief, work, measurements = arrays[0]["belief"], arrays[0]["work"], events.measurements
    arrays[0]["held"]["index"] = -1
    now, index = 0.0, 0
    for k in range(len(measurements.time)):
        kind, sensor, slot = measurements.kind[k], measurements.sensor[k], measurements.slot[k]
        values, R, gap = measurements.values[k], measurements.R[k], measurements.gap[k]
        now, index = advance(arrays[0], events, now, index, measurements.time[k], s, result[k])
        place = Point(measurements.place[k, 0], measurements.place[k, 1])
        m = fill(belief, work, kind, values, R, place, s.factors[sensor])
        if kind == 3:
            reset_to(belief, Pose(values[0], values[1], values[2]), work["R"])
            if slot >= 0:
                start_errors(belief["P"], work["R"], slot)
        if kind == 3 or m == 0:
            continue
        inflation = 1.0
        if slot >= 0:
            renew_errors(belief, work, m, slot, math.exp(-max(gap, MIN_DT) / s.times[sensor]))
        elif s.times[sensor] > 0.0 and gap < math.inf:
            inflation = inflation_after(gap, s.times[sensor])
        take(belief, work, m, inflation, s.gates[m - 1], result[k], WHEELS)


def fill(belief: Any, work: Any, kind: int, values: Any, R: Any, place: Point, factors: Any) -> int:
    """Fill in a measurement; return its number of numbers, 0 if it is not usable."""
    if kind == 0:
        return fill_heading(belief, work, values[0], R[0, 0] * factors[0] ** 2)
    if kind == 1:
        variances = R[0, 0] * factors[0] ** 2, R[1, 1] * factors[1] ** 2
        return fill_landmark(belief, work, values[0], values[1], variances, place)
    m = fill_fix(belief, work, Pose(values[0], values[1], values[2]))
    for i in range(POSE):
        for j in range(POSE):
            work["R"][i, j] = R[i, j] * factors[i // 2] * factors[j // 2]
    return m if R[2, 2] < math.inf else 2


def take(belief: Any, work: Any, m: int, inflation: float, gate: float, result: Any, first: int) -> None:
    """Correct with what was filled in, see :func:`normalise`; write the figures to ``result`` (COLUMNS,).

    Beyond the gate the gain is weighed by gate / NIS, and in the likelihood the NIS counts as
    gate (1 + ln(NIS / gate)), whose derivative is this weight.
    """
    nis, root_det = normalise(belief, work, m, first)
    for i in range(m):
        result[WHITE + i], result[INNOVATION + i] = work["w"][i], work["y"][i]
    beyond = nis > gate
    counted = gate * (1.0 + math.log(nis / gate)) if beyond else nis
    result[NIS], result[NUMBERS], result[WEIGHT] = nis, m, gate / nis if beyond else 1.0
    result[TERM] = -0.5 * (m * LOG_2PI + 2.0 * math.log(root_det) + counted) / inflation
    correct(belief, work, m, inflation, nis / gate if beyond else 1.0)


def take_rate(arrays: Any, motion: Motion, s: Settings, result: Any) -> None:
    """Correct bias and wheels with the turn rate of a whole odometry message, as the filter does.

    It holds for the parts of the message, see :func:`with_held_rate`. The log likelihood is added to ``result``
    (COLUMNS,). See :func:`diffbot_sim.compiled.gated_filter.take_rate`.
    """
    work, held, figures = arrays["work"], arrays["held"], np.zeros(COLUMNS)
    held["value"], held["variance"], held["slip"] = motion.rate.value, motion.rate.variance * motion.dt, 0.0
    if motion.rate.variance == math.inf:
        return
    m = fill_rate(arrays["belief"], work, motion, s.separation)
    take(arrays["belief"], work, m, 1.0, s.gates[0], figures, POSE)
    result[RATES] += figures[TERM]
    if figures[NIS] > s.gates[0]:
        held["slip"] = figures[INNOVATION] * math.sqrt(motion.dt)


def with_held_rate(motion: Motion, held: Any, separation: float) -> Motion:
    """Return a part of a message with the turn rate of the message, and what a contradiction adds to the covariance."""
    dt = motion.dt
    slip = slip_covariance(held["slip"] / math.sqrt(dt), separation)
    rate = TurnRate(held["value"], held["variance"] / dt)
    return Motion(motion.twist, dt, add_twist_covariance(motion.covariance, slip), rate)


def rate_over(rates: Rates, start: float, end: float, factor: float) -> TurnRate:
    """Return the mean turn rate from ``start`` to ``end`` [s]; ``factor`` is on its deviation."""
    time, last = rates.time, len(rates.time) - 1
    if last < 1 or start < time[0] - NANO or end > time[last] + NANO:
        return NO_RATE
    angle, variance = 0.0, 0.0
    for at, sign in ((start, -1.0), (end, 1.0)):
        after = min(max(int(np.searchsorted(time, at)), 1), last)
        share = (at - time[after - 1]) / (time[after] - time[after - 1])
        angle += sign * (rates.angle[after - 1] + share * (rates.angle[after] - rates.angle[after - 1]))
        variance += sign * (rates.variance[after - 1] + share * (rates.variance[after] - rates.variance[after - 1]))
    dt = end - start
    variance /= dt * dt
    return TurnRate(angle / dt, variance * factor**2) if variance < UNKNOWN_RATE else NO_RATE


def start_errors(P: Any, R: Any, slot: int) -> None:
    """Give the error of the fix that the pose was put at to the states of its source's errors."""
    for i in range(POSE):
        for j in range(POSE):
            P[slot + i, slot + j] = R[i, j]
            P[i, slot + j] = P[slot + j, i] = -R[i, j]


def renew_errors(belief: Any, work: Any, m: int, slot: int, c: float) -> None:
    """Let the errors of a source decay to ``c`` of themselves; R is their variance, and none is left beside it."""
    x, P, y, H, R = belief["x"], belief["P"], work["y"], work["H"], work["R"]
    for i in range(slot, slot + m):
        x[i] *= c
        for j in range(len(x)):
            P[i, j] *= c
        for j in range(len(x)):
            P[j, i] *= c
    for i in range(m):
        for j in range(m):
            P[slot + i, slot + j] += (1.0 - c * c) * R[i, j]
            R[i, j] = 0.0
        H[i, slot + i] = 1.0
        # The innovation was taken without the error; an angle is not wrapped again, since errors are small.
        y[i] -= x[slot + i]


def advance(
    arrays: Any, events: Events, now: float, index: int, until: float, s: Settings, result: Any
) -> tuple[float, int]:
    """Move from ``now`` to ``until`` [s] with the messages from ``index`` on; return both as they are then.

    Message k acts from start + delay to end + delay; the first also before, the last also after. To ``result``
    (COLUMNS,) the log likelihood of the turn rates is added.
    """
    odometry, last = events.odometry, len(events.odometry.end) - 1
    while until - now > NANO:
        while index < last and odometry.end[index] + s.delay <= now + NANO:
            index += 1
        whole = odometry.end[index] + s.delay
        end = until if index == last or whole > until else whole
        if s.split:
            end = min(end, next_stamp(odometry, index, now, end))
        motion, lateral = motion_of(odometry, index, end - now, s)
        if len(events.rates.time) > 0:
            if arrays["held"]["index"] != index:
                arrays["held"]["index"] = index
                of_message, _ = motion_of(odometry, index, max(whole, end) - now, s)
                rate = rate_over(events.rates, now, max(whole, end), s.gyro_factor)
                take_rate(arrays, Motion(of_message.twist, of_message.dt, of_message.covariance, rate), s, result)
            motion = with_held_rate(motion, arrays["held"], s.separation)
        predict(arrays["belief"], arrays["work"], motion, lateral, s.separation, s.walk, s.gyro_bias_walk)
        now = end
    return now, index


def motion_of(odometry: Odometry, index: int, dt: float, s: Settings) -> tuple[Motion, float]:
    """Return the motion of ``dt`` [s] of an odometry message, and its variance across the robot [m^2]."""
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
    return Motion(twist, dt, covariance, NO_RATE), lateral


def next_stamp(odometry: Any, index: int, now: float, end: float) -> float:
    """Return the first stamp after ``now`` of the messages from ``index`` on, or ``end`` if there is none before."""
    for later in range(index, len(odometry.end)):
        if odometry.end[later] > now + NANO:
            return min(float(odometry.end[later]), end)
    return end


CALLED = (
    fill, take, take_rate, with_held_rate, rate_over, advance, motion_of, next_stamp, start_errors, renew_errors,
)  # fmt: skip
"""Functions that :func:`run_filter` calls."""
