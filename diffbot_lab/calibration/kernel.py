"""The filter over the arrays of a drive, to be compiled: the models are the functions of the filter, the algebra is here.

States: x, y, theta, relative errors of the left and right radius and of the wheel separation, offset [m] and scale of the
landmark ranges, offset [rad] of the bearings; and, if the errors of fixes are modelled as correlated in time, their
present error (x, y, theta). Arrays are changed in place: this is the inner loop of an optimisation.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from diffbot_control.filter.correlation import inflation_after
from diffbot_control.filter.landmark_calibration import LandmarkErrors, with_landmark_errors
from diffbot_control.filter.models import (
    TURNED_VARIANCE,
    RadiusErrors,
    arc_correction,
    expect_landmark,
    heading_innovation,
    is_at_landmark,
    lateral_noise,
    motion_noise,
    move,
    pose_innovation,
    radius_derivatives,
    separation_derivatives,
    with_radius_errors,
    with_separation_error,
)
from diffbot_control.filter.odometry_noise import MotionDensity, motion_density, over_time
from diffbot_core.geometry import Point, Pose, wrap_angle
from diffbot_core.kinematics import Twist, TwistCovariance, scale_twist_covariance

STATES, WITH_BIAS = 9, 12
OFFSET, SCALE, YAW, BIAS = 6, 7, 8, 9
"""Indices of states."""
NIS, NUMBERS, TERM, WHITE, INNOVATION, WEIGHT, COLUMNS = 0, 1, 2, 3, 6, 9, 10
"""Columns of the result: NIS, count of numbers, log likelihood, whitened innovation (3), innovation (3), weight."""
MESSAGE, DENSITY, MOTION = 0, 1, 2
_LOG_2PI = math.log(2.0 * math.pi)
_NEVER = -1.0
_NANO = 1e-9


class Settings(NamedTuple):
    """Plain numbers of a filter; names as in its parameters, the deviations as factors on what the events have."""

    separation: float
    """L [m]"""
    walk: float
    """[1/s] random-walk variance per second of each wheel error"""
    delay: float
    """[s]"""
    noise: int
    """MESSAGE, DENSITY or MOTION"""
    odometry_covariance_scale: float
    alpha1: float
    alpha2: float
    alpha3: float
    alpha4: float
    density_xy: float
    density_theta: float
    gates: tuple[float, float, float]
    """bounds of the NIS by number of values, beyond which a measurement is weighed by bound / NIS"""
    times: tuple[float, float, float]
    """[s] correlation times of headings, of each landmark, of fixes; 0: independent"""
    fix_bias: bool
    """correlated errors of fixes are states; otherwise their R is inflated"""
    range_factor: float
    """on the standard deviation of ranges; likewise the next ones"""
    bearing_factor: float
    heading_factor: float
    xy_factor: float
    yaw_factor: float
    split: bool
    """move to each odometry stamp, as the filter does, although the twist does not change there with a delay"""


class Work(NamedTuple):
    """Arrays that are used again at each step."""

    FP: Any
    """(3, n) first rows of F P"""
    H: Any
    """(3, n)"""
    PHT: Any
    """(n, 3)"""
    y: Any
    """(3,)"""
    R: Any
    """(3, 3)"""
    L: Any
    """(3, 3) Cholesky factor"""
    w: Any
    """(3,)"""


def run_filter(
    odometry: Any, measurements: Any, starts_from_fix: bool, x: Any, P: Any, result: Any, s: Settings
) -> None:
    """Filter a drive.

    Args:
        odometry: see :class:`events.Odometry`.
        measurements: see :class:`events.Measurements`; the first is a reset.
        starts_from_fix: its error may be correlated with those of the next fixes.
        x: (n,) mean of the states before the first reset; becomes that at the end.
        P: (n, n) likewise.
        result: (k, COLUMNS) becomes the figures of each measurement; a reset, or a landmark where the robot stands, has
            zero numbers.
        s: of the filter.
    """
    n = len(x)
    work = Work(
        np.zeros((3, n)),
        np.zeros((3, n)),
        np.zeros((n, 3)),
        np.zeros(3),
        np.zeros((3, 3)),
        np.zeros((3, 3)),
        np.zeros(3),
    )
    last = np.full(len(measurements.time) + 1, _NEVER)
    now, index = 0.0, 0
    for k in range(len(measurements.time)):
        time, kind, source = measurements.time[k], measurements.kind[k], measurements.source[k]
        now, index = advance(x, P, work, odometry, now, index, time, s)
        if kind == 3:
            reset(x, P, measurements.values[k], measurements.R[k], n)
            if starts_from_fix and k == 0:
                last[source] = time
                if s.fix_bias:
                    start_bias(P, measurements.R[k])
            continue
        m = fill(x, P, work, measurements, k, s)
        inflation = 1.0
        if kind == 2 and s.fix_bias:
            gap = time - last[source] if last[source] >= 0.0 else math.inf
            remember(x, P, work, math.exp(-gap / s.times[2]))
        elif m > 0 and s.times[kind] > 0.0 and last[source] >= 0.0:
            inflation = inflation_after(time - last[source], s.times[kind])
        last[source] = time
        if m > 0:
            correct(x, P, work, m, inflation, s.gates[m - 1], result[k])


def advance(
    x: Any, P: Any, work: Work, odometry: Any, now: float, index: int, until: float, s: Settings
) -> tuple[float, int]:
    """Move from ``now`` to ``until`` [s] with the messages from ``index`` on; return both as they are then.

    Message k acts from start + delay to end + delay; the first also before, the last also after.
    """
    last = len(odometry.end) - 1
    while until - now > _NANO:
        while index < last and odometry.end[index] + s.delay <= now + _NANO:
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
        if known and s.noise == 0:
            covariance = scale_twist_covariance(covariance, (odometry.end[index] - odometry.start[index]) / dt)
        elif known and s.noise == 1:
            covariance, lateral = over_time(MotionDensity(covariance, 0.0), twist.v, dt)
        else:
            covariance, lateral = over_time(motion_density(twist, s), twist.v, dt)  # type: ignore[arg-type]
        predict(x, P, work.FP, twist, dt, covariance, lateral, s)
        now = end
    return now, index


def next_stamp(odometry: Any, index: int, now: float, end: float) -> float:
    """Return the first stamp after ``now`` of the messages from ``index`` on, or ``end`` if there is none before."""
    for later in range(index, len(odometry.end)):
        if odometry.end[later] > now + _NANO:
            return min(float(odometry.end[later]), end)
    return end


def predict(
    x: Any, P: Any, FP: Any, measured: Twist, dt: float, covariance: TwistCovariance, lateral: float, s: Settings
) -> None:
    """Move mean and covariance: P = F P F' + Q, of which F differs from 1 in the first three rows."""
    twist = with_separation_error(with_radius_errors(measured, RadiusErrors(x[3], x[4]), s.separation), x[5])
    arc = move(Pose(x[0], x[1], x[2]), twist, dt)
    radii = radius_derivatives(arc, measured, dt, s.separation, 1.0 + x[5])
    x_sep, y_sep, theta_sep = separation_derivatives(arc, twist, dt, x[5])
    xx, xy, xt, yy, yt, tt = motion_noise(arc, twist.v, dt, covariance)
    add_xx, add_xy, add_yy = lateral_noise(arc, dt, lateral)
    x[0], x[1], x[2] = arc.end.x, arc.end.y, arc.end.theta
    n = len(x)
    for j in range(n):
        left, right, separation = P[3, j], P[4, j], P[5, j]
        FP[0, j] = P[0, j] + arc.x_theta * P[2, j] + radii.x_left * left + radii.x_right * right + x_sep * separation
        FP[1, j] = P[1, j] + arc.y_theta * P[2, j] + radii.y_left * left + radii.y_right * right + y_sep * separation
        FP[2, j] = P[2, j] + radii.theta_left * left + radii.theta_right * right + theta_sep * separation
    for i in range(3):
        a, left, right, separation = FP[i, 2], FP[i, 3], FP[i, 4], FP[i, 5]
        P[i, 0] = FP[i, 0] + arc.x_theta * a + radii.x_left * left + radii.x_right * right + x_sep * separation
        P[i, 1] = FP[i, 1] + arc.y_theta * a + radii.y_left * left + radii.y_right * right + y_sep * separation
        P[i, 2] = a + radii.theta_left * left + radii.theta_right * right + theta_sep * separation
        for j in range(3, n):
            P[i, j] = P[j, i] = FP[i, j]
    P[0, 0] += xx + add_xx
    P[1, 1] += yy + add_yy
    P[2, 2] += tt
    P[0, 1] = P[1, 0] = P[0, 1] + xy + add_xy
    P[0, 2] = P[2, 0] = P[0, 2] + xt
    P[1, 2] = P[2, 1] = P[1, 2] + yt
    for i in range(3, 6):
        P[i, i] += s.walk * dt


def reset(x: Any, P: Any, pose: Any, R: Any, n: int) -> None:
    """Put the pose at ``pose`` (3,) with covariance ``R`` (3, 3), uncorrelated with the other states, which stay."""
    for i in range(3):
        x[i] = pose[i]
        for j in range(n):
            P[i, j] = P[j, i] = 0.0
    x[2] = wrap_angle(x[2])
    for i in range(3):
        for j in range(3):
            P[i, j] = R[i, j]


def start_bias(P: Any, R: Any) -> None:
    """Give the error of the fix that the pose was put at to the states of the fixes' error."""
    for i in range(3):
        for j in range(3):
            P[9 + i, 9 + j] = R[i, j]
            P[i, 9 + j] = P[9 + j, i] = -R[i, j]


def remember(x: Any, P: Any, work: Work, c: float) -> None:
    """Let the error of the fixes decay to ``c`` of itself; all of R in ``work`` is its variance, none is left there."""
    n = len(x)
    for i in range(9, 12):
        x[i] *= c
        for j in range(n):
            P[i, j] *= c
        for j in range(n):
            P[j, i] *= c
    for i in range(3):
        for j in range(3):
            P[9 + i, 9 + j] += (1.0 - c * c) * work.R[i, j]
            work.R[i, j] = 0.0
        work.H[i, 9 + i] = 1.0
    # The innovation was taken without the error; an angle is not wrapped again, since errors are small.
    for i in range(3):
        work.y[i] -= x[9 + i]


def fill(x: Any, P: Any, work: Work, measurements: Any, k: int, s: Settings) -> int:
    """Fill innovation, Jacobian and R of measurement ``k``; return how many numbers it has, 0: not usable."""
    kind, values, R = measurements.kind[k], measurements.values[k], measurements.R[k]
    y, H = work.y, work.H
    H[:, :] = 0.0
    work.R[:, :] = 0.0
    if kind == 0:
        y[0] = heading_innovation(values[0], x[2])
        H[0, 2] = 1.0
        work.R[0, 0] = R[0, 0] * s.heading_factor**2
        return 1
    if kind == 2:
        y[0], y[1], y[2] = pose_innovation(Pose(values[0], values[1], values[2]), Pose(x[0], x[1], x[2]))
        for i in range(3):
            H[i, i] = 1.0
            for j in range(3):
                by_row = s.yaw_factor if i == 2 else s.xy_factor
                by_column = s.yaw_factor if j == 2 else s.xy_factor
                work.R[i, j] = R[i, j] * by_row * by_column
        return 3
    return fill_landmark(x, P, work, values, R, Point(measurements.place[k, 0], measurements.place[k, 1]), s)


def fill_landmark(x: Any, P: Any, work: Work, values: Any, R: Any, place: Point, s: Settings) -> int:
    """Fill range and bearing of a landmark, or one of them."""
    pose = Pose(x[0], x[1], x[2])
    if is_at_landmark(pose, place):
        return 0
    known = expect_landmark(pose, place, P[0, 0] + P[1, 1])
    expected = with_landmark_errors(known, LandmarkErrors(x[6], x[7], x[8]))
    y, H, row = work.y, work.H, 0
    if math.isfinite(R[0, 0]):
        y[0] = values[0] - expected.range
        H[0, 0], H[0, 1] = expected.range_x, expected.range_y
        H[0, 6], H[0, 7] = 1.0, known.range
        work.R[0, 0] = R[0, 0] * s.range_factor**2 + expected.added_var_range
        row = 1
    if math.isfinite(R[1, 1]):
        y[row] = heading_innovation(values[1], expected.bearing)
        H[row, 0], H[row, 1], H[row, 2], H[row, 8] = expected.bearing_x, expected.bearing_y, -1.0, 1.0
        work.R[row, row] = R[1, 1] * s.bearing_factor**2 + expected.added_var_bearing
        row += 1
    return row


def correct(x: Any, P: Any, work: Work, m: int, inflation: float, gate: float, result: Any) -> None:
    """Correct with what was filled in; write the figures to ``result`` (COLUMNS,).

    Beyond the gate the gain is weighed by gate / NIS, and the NIS counts as gate (1 + ln(NIS / gate)) in the likelihood,
    whose derivative is this weight.
    """
    n = len(x)
    y, H, R, L, w, PHT = work.y, work.H, work.R, work.L, work.w, work.PHT
    for i in range(n):
        for j in range(m):
            PHT[i, j] = 0.0
            for q in range(n):
                PHT[i, j] += P[i, q] * H[j, q]
    log_det = factorise(work, m, n, 1.0, 1.0)
    nis = 0.0
    for i in range(m):
        w[i] = y[i]
        for j in range(i):
            w[i] -= L[i, j] * w[j]
        w[i] /= L[i, i]
        nis += w[i] * w[i]
        result[3 + i], result[6 + i] = w[i], y[i]
    beyond = nis > gate
    counted = gate * (1.0 + math.log(nis / gate)) if beyond else nis
    result[0], result[1], result[9] = nis, m, gate / nis if beyond else 1.0
    result[2] = -0.5 * (m * _LOG_2PI + log_det + counted) / inflation
    if inflation != 1.0 or beyond:
        factorise(work, m, n, inflation, nis / gate if beyond else 1.0)
        for i in range(m):
            w[i] = y[i]
            for j in range(i):
                w[i] -= L[i, j] * w[j]
            w[i] /= L[i, i]
    # PHT L^-T, row by row; then the gain times y is its product with w.
    for i in range(n):
        for j in range(m):
            for q in range(j):
                PHT[i, j] -= L[j, q] * PHT[i, q]
            PHT[i, j] /= L[j, j]
    apply(x, P, PHT, w, m, n)


def factorise(work: Work, m: int, n: int, inflation: float, weaker: float) -> float:
    """Put the Cholesky factor of (H P H' + inflation R) weaker to ``work.L``; return the log of the determinant."""
    H, R, L, PHT = work.H, work.R, work.L, work.PHT
    log_det = 0.0
    for i in range(m):
        for j in range(i + 1):
            value = inflation * R[i, j]
            for q in range(n):
                value += H[i, q] * PHT[q, j]
            value *= weaker
            for q in range(j):
                value -= L[i, q] * L[j, q]
            if i == j:
                L[i, i] = math.sqrt(max(value, 1e-300))
                log_det += 2.0 * math.log(L[i, i])
            else:
                L[i, j] = value / L[j, j]
    return log_det


def apply(x: Any, P: Any, gain: Any, w: Any, m: int, n: int) -> None:
    """Correct mean and covariance with the whitened ``gain`` (n, m) and innovation ``w`` (m,)."""
    turned = P[2, 2] > TURNED_VARIANCE
    dx, dy, turn = 0.0, 0.0, 0.0
    for q in range(m):
        dx += gain[0, q] * w[q]
        dy += gain[1, q] * w[q]
        turn += gain[2, q] * w[q]
    for i in range(n):
        for q in range(m):
            x[i] += gain[i, q] * w[q]
        for j in range(i + 1):
            for q in range(m):
                P[i, j] -= gain[i, q] * gain[j, q]
            P[j, i] = P[i, j]
    x[2] = wrap_angle(x[2])
    if not turned:
        return
    along_x, along_y = arc_correction(dx, dy, turn)
    x[0] += along_x - dx
    x[1] += along_y - dy
    c, s = math.cos(turn), math.sin(turn)
    for j in range(n):
        P[0, j], P[1, j] = c * P[0, j] - s * P[1, j], s * P[0, j] + c * P[1, j]
    for j in range(n):
        P[j, 0], P[j, 1] = c * P[j, 0] - s * P[j, 1], s * P[j, 0] + c * P[j, 1]
