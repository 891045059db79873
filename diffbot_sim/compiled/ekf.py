"""The Kalman filter of :mod:`diffbot_control.filter.ekf` on arrays that are changed in place, for compiled code.

It serves campaigns (:mod:`diffbot_sim.compiled.gated_filter`) and ``diffbot calibrate``. The models are the same
functions; a test holds the algebra to filterpy's filter.

The first n of these states, where n is 6, or 10 and more: x, y, theta; relative errors of the radii, left, right, and
of the wheel separation; offset [m] and scale of the ranges to landmarks, and offset [rad] of their bearings; bias of
the gyro [rad/s]; errors of single sources, where those of neighbouring measurements are correlated. An error whose
variance is zero is known: it stays.

Arrays stand in numpy's records, which compiled code knows by one address and with sizes that are constants.
A measurement is taken in three steps: fill in what is measured and expected, :func:`normalise` it, :func:`correct`.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from diffbot_control.filter.averaging import Three, log_density_ratio, probability
from diffbot_control.filter.landmark_calibration import LandmarkErrors, with_landmark_errors
from diffbot_control.filter.models import (
    TURNED_VARIANCE,
    GyroShare,
    Motion,
    WheelErrors,
    arc_correction,
    covariance_with_rate,
    derivatives_with_rate,
    expect_landmark,
    gyro_share,
    heading_innovation,
    is_at_landmark,
    lateral_noise,
    motion_noise,
    move,
    pose_derivatives,
    pose_innovation,
    rate_derivatives,
    twist_derivatives,
    with_rate,
    with_wheel_errors,
)
from diffbot_core.geometry import Point, Pose, wrap_angle
from diffbot_core.kinematics import Twist

POSE, WHEELS, LANDMARKS, GYRO = 3, 6, 9, 10
"""Number of states up to and including these."""
_SMALLEST = 1e-300
"""Variance that stands for one that rounding has made negative."""


def belief_type(n: int) -> Any:
    """Return the type of a record with mean x (n,) and covariance P (n, n)."""
    return np.dtype([("x", float, (n,)), ("P", float, (n, n))])


def work_type(n: int) -> Any:
    """Return the type of a record for the newest measurement, of m <= 3 numbers, and for what is computed on the way.

    y (3,) innovation, H (3, n) its Jacobian, R (3, 3) covariance of the measured numbers, S = H P H' (3, 3), L (3, 3)
    Cholesky factor of the innovation's covariance with the reciprocals of its diagonal, w = L^-1 y (3,), PHT = P H'
    (n, 3), all with m rows or columns that count; D (3, 5) derivatives of a moved pose by heading, errors of the wheels
    and bias, FP (3, n) rows of F P.
    """
    shapes = {"y": (3,), "H": (3, n), "R": (3, 3), "S": (3, 3), "L": (3, 3), "w": (3,), "PHT": (n, 3)}
    return np.dtype([(name, float, shape) for name, shape in {**shapes, "D": (3, 5), "FP": (3, n)}.items()])


class Normalised(NamedTuple):
    """How far a measurement is from what was expected."""

    nis: float
    """normalised innovation squared"""
    root_det: float
    """square root of the determinant of the innovation's covariance"""


def pose_of(belief: Any) -> Pose:
    """Return the mean pose."""
    x = belief["x"]
    return Pose(x[0], x[1], x[2])


def copy_to(target: Any, belief: Any) -> None:
    """Overwrite ``target``."""
    n = len(target["x"])
    for i in range(n):
        target["x"][i] = belief["x"][i]
        for j in range(n):
            target["P"][i, j] = belief["P"][i, j]


def average_over(belief: Any, given: Any, first: int, configured: Three, variances: Three, prior: float) -> None:
    """Average ``belief`` over both hypotheses as :func:`averaging.average_over` does; ``given`` is overwritten."""
    copy_to(given, belief)
    x, P, n, log_ratio = given["x"], given["P"], len(given["x"]), 0.0
    for i in range(3):
        at = first + i
        variance, shift = P[at, at], configured[i] - x[at]
        if variances[i] <= 0.0 or variance <= 0.0:
            continue
        log_ratio += log_density_ratio(shift, variance, variances[i])
        for a in range(n):
            gain = P[a, at] / variance
            x[a] += gain * shift
            for b in range(a + 1):
                if at not in (a, b):
                    P[a, b] -= gain * P[b, at]
        for a in range(n):
            P[a, at] = P[at, a] = 0.0
            for b in range(a):
                P[b, a] = P[a, b]
    share = probability(log_ratio, prior)
    mean, covariance = belief["x"], belief["P"]
    for a in range(n):
        for b in range(a + 1):
            spread = (1.0 - share) * (x[a] - mean[a]) * (x[b] - mean[b])
            covariance[a, b] += share * (P[a, b] - covariance[a, b] + spread)
            covariance[b, a] = covariance[a, b]
    for a in range(n):
        mean[a] += share * (x[a] - mean[a])
    mean[2] = wrap_angle(mean[2])


def reset_to(belief: Any, pose: Pose, R: Any) -> None:
    """Put the pose at ``pose`` with covariance ``R`` (3, 3), uncorrelated with the other states, which stay."""
    x, P = belief["x"], belief["P"]
    x[0], x[1], x[2] = pose.x, pose.y, wrap_angle(pose.theta)
    for i in range(POSE):
        for j in range(len(x)):
            P[i, j] = P[j, i] = 0.0
    for i in range(POSE):
        for j in range(POSE):
            P[i, j] = R[i, j]


def inflate(belief: Any, factor: float) -> None:
    """Multiply the pose's part of P; the covariance of the other states stays."""
    P, root = belief["P"], math.sqrt(factor)
    for i in range(POSE):
        for j in range(len(P)):
            P[i, j] *= root
            P[j, i] *= root


def corrected_twist(belief: Any, measured: Twist, separation: float) -> Twist:
    """Return the twist of wheels with the estimated errors; ``separation`` is their configured distance [m]."""
    x = belief["x"]
    return with_wheel_errors(measured, WheelErrors(x[3], x[4], x[5]), separation)


def predict(
    belief: Any,
    work: Any,
    motion: Motion,
    var_lateral: float,
    separation: float,
    random_walk: float,
    bias_random_walk: float,
) -> None:
    """Move: P = F P F' + Q.

    Args:
        belief: to be moved.
        work: arrays.
        motion: twist from the encoders for wheels of the configured size, duration, covariance of the twist.
        var_lateral: variance of the motion across the robot [m^2].
        separation: configured distance of the wheels [m].
        random_walk: [1/s] random-walk variance per second of each error of the wheels that is not known.
        bias_random_walk: [rad^2/s^3] of the gyro's bias.
    """
    x, P = belief["x"], belief["P"]
    measured, dt, covariance, rate = motion
    twist = corrected_twist(belief, measured, separation)
    by, share = twist_derivatives(measured, twist.omega, separation, x[5]), GyroShare(0.0, 0.0)
    if len(x) >= GYRO:
        share = gyro_share(covariance, rate)
        twist = with_rate(twist, rate.value - x[LANDMARKS] - twist.omega, share)
        covariance = covariance_with_rate(covariance, share)
    arc, D = move(pose_of(belief), twist, dt), work["D"]
    D[0, 0], D[1, 0] = arc.x_theta, arc.y_theta
    pairs = (by.v_left, by.omega_left), (by.v_right, by.omega_right), (0.0, by.omega_separation)
    for k in range(3):
        v, omega = derivatives_with_rate(pairs[k][0], pairs[k][1], share)
        D[0, 1 + k], D[1, 1 + k], D[2, 1 + k] = pose_derivatives(arc, dt, v, omega)
    D[0, 4], D[1, 4], D[2, 4] = pose_derivatives(arc, dt, -share.v, -share.omega)
    x[0], x[1], x[2] = arc.end.x, arc.end.y, arc.end.theta
    propagate(P, D, work["FP"])
    xx, xy, xt, yy, yt, tt = motion_noise(arc, twist.v, dt, covariance)
    if var_lateral > 0.0:
        add_xx, add_xy, add_yy = lateral_noise(arc, dt, var_lateral)
        xx, xy, yy = xx + add_xx, xy + add_xy, yy + add_yy
    P[0, 0] += xx
    P[1, 1] += yy
    P[2, 2] += tt
    P[0, 1] = P[1, 0] = P[0, 1] + xy
    P[0, 2] = P[2, 0] = P[0, 2] + xt
    P[1, 2] = P[2, 1] = P[1, 2] + yt
    for i in range(POSE, WHEELS):
        if P[i, i] > 0.0:
            P[i, i] += random_walk * dt
    if len(x) >= GYRO and P[LANDMARKS, LANDMARKS] > 0.0:
        P[LANDMARKS, LANDMARKS] += bias_random_walk * dt


def propagate(P: Any, D: Any, FP: Any) -> None:
    """P = F P F', where F adds D times theta, the errors of the wheels and the bias to the pose."""
    n = len(P)
    for i in range(POSE):
        for j in range(n):
            value = P[i, j]
            for k in range(4):
                value += D[i, k] * P[2 + k, j]
            if n >= GYRO:
                value += D[i, 4] * P[LANDMARKS, j]
            FP[i, j] = value
    for i in range(POSE):
        for j in range(i, POSE):
            value = FP[i, j]
            for k in range(4):
                value += FP[i, 2 + k] * D[j, k]
            if n >= GYRO:
                value += FP[i, LANDMARKS] * D[j, 4]
            P[i, j] = P[j, i] = value
        for j in range(POSE, n):
            P[i, j] = P[j, i] = FP[i, j]


def _clear(work: Any) -> None:
    H, R = work["H"], work["R"]
    for i in range(3):
        for j in range(H.shape[1]):
            H[i, j] = 0.0
        for j in range(3):
            R[i, j] = 0.0


def fill_fix(belief: Any, work: Any, measured: Pose) -> int:
    """Fill in a measured pose; its R is to be filled in by the caller. Return the number of numbers, m."""
    _clear(work)
    y, H = work["y"], work["H"]
    y[0], y[1], y[2] = pose_innovation(measured, pose_of(belief))
    for i in range(POSE):
        H[i, i] = 1.0
    return 3


def fill_heading(belief: Any, work: Any, measured: float, variance: float) -> int:
    """Fill in a heading [rad] of this variance [rad^2]; return the number of numbers, m."""
    _clear(work)
    work["y"][0] = heading_innovation(measured, belief["x"][2])
    work["H"][0, 2] = 1.0
    work["R"][0, 0] = variance
    return 1


def fill_landmark(
    belief: Any, work: Any, distance: float, bearing: float, variances: tuple[float, float], landmark: Point
) -> int:
    """Fill in range [m] and bearing [rad] of a landmark.

    Args:
        belief: the estimate.
        work: to be filled.
        distance: measured [m].
        bearing: measured [rad].
        variances: of both [m^2], [rad^2]; one that is not finite marks a missing number.
        landmark: its position [m].

    Returns:
        The number of numbers, m; 0 if nothing can be expected, since the robot stands at the landmark.
    """
    x, P = belief["x"], belief["P"]
    pose = pose_of(belief)
    if is_at_landmark(pose, landmark):
        return 0
    known = expect_landmark(pose, landmark, P[0, 0] + P[1, 1])
    expected, calibrated = known, len(x) > WHEELS
    if calibrated:
        expected = with_landmark_errors(known, LandmarkErrors(x[6], x[7], x[8]))
    _clear(work)
    y, H, R, m = work["y"], work["H"], work["R"], 0
    if math.isfinite(variances[0]):
        y[0] = distance - expected.range
        H[0, 0], H[0, 1] = expected.range_x, expected.range_y
        R[0, 0] = variances[0] + expected.added_var_range
        if calibrated:
            H[0, 6], H[0, 7] = 1.0, known.range
        m = 1
    if math.isfinite(variances[1]):
        y[m] = heading_innovation(bearing, expected.bearing)
        H[m, 0], H[m, 1], H[m, 2] = expected.bearing_x, expected.bearing_y, -1.0
        R[m, m] = variances[1] + expected.added_var_bearing
        if calibrated:
            H[m, 8] = 1.0
        m += 1
    return m


def fill_rate(belief: Any, work: Any, motion: Motion, separation: float) -> int:
    """Fill in the turn rate of a gyro against the wheels'; it must be a state. Return the number of numbers, m."""
    x, H = belief["x"], work["H"]
    twist, share = corrected_twist(belief, motion.twist, separation), gyro_share(motion.covariance, motion.rate)
    difference = motion.rate.value - twist.omega - x[LANDMARKS]
    by = rate_derivatives(motion.twist, twist, difference, share, separation, x[5])
    _clear(work)
    work["y"][0] = difference
    H[0, 3], H[0, 4], H[0, 5], H[0, LANDMARKS] = by.omega_left, by.omega_right, by.omega_separation, 1.0
    work["R"][0, 0] = motion.rate.variance + motion.covariance.var_omega
    return 1


def normalise(belief: Any, work: Any, m: int, first: int = WHEELS) -> Normalised:
    """Whiten the innovation of the ``m`` numbers that were filled in.

    ``first``: state from which on they depend on errors; only a turn rate depends on those of the wheels.
    """
    P, H, S, PHT, w = belief["P"], work["H"], work["S"], work["PHT"], work["w"]
    n = len(P)
    for i in range(n):
        for j in range(m):
            value = P[i, 0] * H[j, 0] + P[i, 1] * H[j, 1] + P[i, 2] * H[j, 2]
            for q in range(first, n):
                value += P[i, q] * H[j, q]
            PHT[i, j] = value
    for i in range(m):
        for j in range(i + 1):
            value = H[i, 0] * PHT[0, j] + H[i, 1] * PHT[1, j] + H[i, 2] * PHT[2, j]
            for q in range(first, n):
                value += H[i, q] * PHT[q, j]
            S[i, j] = value
    root_det = _factorise(work, m, 1.0, 1.0)
    nis = 0.0
    for i in range(m):
        nis += w[i] * w[i]
    return Normalised(nis, root_det)


def _factorise(work: Any, m: int, inflation: float, weaker: float) -> float:
    """Factorise (H P H' + inflation R) weaker = L L', whiten y by it, and return the determinant of L."""
    y, R, S, L, w = work["y"], work["R"], work["S"], work["L"], work["w"]
    det = 1.0
    for i in range(m):
        for j in range(i + 1):
            value = (S[i, j] + inflation * R[i, j]) * weaker
            for q in range(j):
                value -= L[i, q] * L[j, q]
            if i == j:
                root = math.sqrt(max(value, _SMALLEST))
                L[i, i] = 1.0 / root
                det *= root
            else:
                L[i, j] = value * L[j, j]
        value = y[i]
        for q in range(i):
            value -= L[i, q] * w[q]
        w[i] = value * L[i, i]
    return det


def correct(belief: Any, work: Any, m: int, inflation: float, weaker: float) -> None:
    """Correct with the ``m`` numbers for which :func:`normalise` was called last, for this belief.

    Args:
        belief: to be corrected.
        work: with the measurement.
        m: number of numbers.
        inflation: factor on R in the gain, for errors that are correlated with those of the measurement before.
        weaker: factor on the innovation's covariance in the gain, beyond the gate of a measurement that is weighed.
    """
    x, P = belief["x"], belief["P"]
    n, L, w, gain = len(x), work["L"], work["w"], work["PHT"]
    if inflation != 1.0 or weaker != 1.0:
        _factorise(work, m, inflation, weaker)
    # The gain of the whitened innovation, P H' L^-T, row by row in the place of P H'.
    for i in range(n):
        for j in range(m):
            value = gain[i, j]
            for q in range(j):
                value -= L[j, q] * gain[i, q]
            gain[i, j] = value * L[j, j]
    uncertain, dx, dy, turn = P[2, 2] > TURNED_VARIANCE, 0.0, 0.0, 0.0
    for q in range(m):
        dx += gain[0, q] * w[q]
        dy += gain[1, q] * w[q]
        turn += gain[2, q] * w[q]
    for i in range(n):
        for q in range(m):
            x[i] += gain[i, q] * w[q]
        for j in range(i + 1):
            value = P[i, j]
            for q in range(m):
                value -= gain[i, q] * gain[j, q]
            P[i, j] = P[j, i] = value
    x[2] = wrap_angle(x[2])
    if uncertain:
        _turn(belief, dx, dy, turn)


def _turn(belief: Any, dx: float, dy: float, turn: float) -> None:
    """Turn a correction of the pose into one along an arc, see :func:`models.arc_correction`."""
    x, P = belief["x"], belief["P"]
    along_x, along_y = arc_correction(dx, dy, turn)
    x[0] += along_x - dx
    x[1] += along_y - dy
    c, s = math.cos(turn), math.sin(turn)
    for j in range(len(x)):
        P[0, j], P[1, j] = c * P[0, j] - s * P[1, j], s * P[0, j] + c * P[1, j]
    for j in range(len(x)):
        P[j, 0], P[j, 1] = c * P[j, 0] - s * P[j, 1], s * P[j, 0] + c * P[j, 1]
