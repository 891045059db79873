"""Models of the filter: motion and expected measurements, with their derivatives.

The state is x, y [m] and theta [rad] in the frame of the fixes. Optional further states are the relative errors of the
left and right wheel radius and of the wheel separation, the bias of a gyro [rad/s], offset [m] and scale [-] of the
ranges to landmarks, and offset [rad] of their bearings. n is 3, 6, 7 or 10, see :func:`state_size`.

All functions work on arrays and records of floats. They run as plain Python and, compiled unchanged, in the simulation.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from diffbot_core.geometry import Point, Pose, wrap_angle
from diffbot_core.kinematics import Twist, TwistCovariance

Array = NDArray[np.float64]

WHEELS, BIAS, SENSOR = 3, 6, 7
"""Indices of the first error of the wheels, of the gyro's bias, and of the first error of the landmark sensor."""
POSE_FIX, POSITION_FIX, HEADING, LANDMARK, RANGE, BEARING = 0, 1, 2, 3, 4, 5
"""Kinds of measurements; a landmark is measured by range and bearing or by one of them."""
UNKNOWN_HEADING = math.pi**2
"""[rad^2] Variance of a heading of which nothing is known."""
MIN_LANDMARK_DISTANCE = 1e-3
"""[m] The bearing of a landmark that is nearer carries no information."""


class TurnRate(NamedTuple):
    """Mean turn rate over a time, measured by a gyro."""

    value: float
    """[rad/s]"""
    variance: float
    """[rad^2/s^2] of the mean; inf: not measured"""


NO_RATE = TurnRate(0.0, math.inf)


class Motion(NamedTuple):
    """Mean twist over a time: the filter's input."""

    twist: Twist
    """measured by wheels that are assumed to have the configured size"""
    dt: float
    """[s]"""
    covariance: TwistCovariance
    rate: TurnRate = NO_RATE
    """turn rate measured by a gyro over the same time"""
    lateral: float = 0.0
    """[m^2] variance of the motion across the robot"""


class Reading(NamedTuple):
    """One measurement as numbers."""

    kind: int
    """POSE_FIX, POSITION_FIX, HEADING, LANDMARK, RANGE or BEARING"""
    source: int
    """row of its source's noise statistics"""
    place: int
    """row of the previous measurement whose error may be correlated with this one's"""
    time: float
    """[s] time of the measurement since any fixed time"""
    z: Any
    """(m,) array of the numbers of its kind [m], [rad]"""
    R: Any
    """(m, m) array, their covariance"""
    at: Point = Point(0.0, 0.0)
    """position of the landmark [m]"""


class GyroShare(NamedTuple):
    """Change of the twist per rad/s by which the gyro's turn rate exceeds the wheels'."""

    v: float
    """[m]"""
    omega: float
    """[-]"""


class Moved(NamedTuple):
    """A motion of the state."""

    x: Any
    """(n,) array, the moved mean"""
    F: Any
    """(n, n) array, derivative with respect to the mean before the motion"""
    Q: Any
    """(n, n) array, covariance that the motion adds"""


class Expected(NamedTuple):
    """A measurement compared with its expected value."""

    y: Any
    """(m,) array, measured minus expected numbers; angles are wrapped"""
    H: Any
    """(m, n) array, derivative of the expected numbers with respect to the state"""
    R: Any
    """(m, m) array, covariance of the measurement and of the linearisation error"""


class RateExpected(NamedTuple):
    """A turn rate of a gyro compared with that of the wheels."""

    y: float
    """[rad/s] measured minus expected"""
    H: Any
    """(1, n) array"""
    variance: float
    """[rad^2/s^2] sum of the variances of gyro and wheels"""


def state_size(calibrating: bool, gyro: bool, landmarks: bool) -> int:
    """Return n for a filter that estimates errors of the wheels, the bias of a gyro, errors of the landmark sensor.

    Errors that are not estimated, but precede an estimated one, are states with the variance 0.
    """
    if landmarks:
        return 10
    if gyro:
        return 7
    return 6 if calibrating else 3


def with_wheel_errors(twist: Twist, x: Array, separation: float) -> Twist:
    """Return the twist of wheels that have the errors in the state ``x`` (n,).

    With the rim speeds v_l and v_r: v + (v_l e_l + v_r e_r) / 2 and (omega + (v_r e_r - v_l e_l) / L) / (1 + e_s);
    ``separation`` is L [m].
    """
    if len(x) <= WHEELS:
        return twist
    v, omega = twist
    left, right = (v - 0.5 * separation * omega) * float(x[3]), (v + 0.5 * separation * omega) * float(x[4])
    return Twist(v + 0.5 * (left + right), (omega + (right - left) / separation) / (1.0 + float(x[5])))


def gyro_share(covariance: TwistCovariance, rate: TurnRate) -> GyroShare:
    """Return the gain of a turn rate on a twist of this ``covariance``; 0 if the turn rate was not measured."""
    total = covariance.var_omega + rate.variance
    return GyroShare(covariance.cov_v_omega / total, covariance.var_omega / total)


def with_rate(twist: Twist, difference: float, share: GyroShare) -> Twist:
    """Return a twist corrected by the ``difference`` [rad/s] between the gyro's turn rate and its own."""
    return Twist(twist.v + share.v * difference, twist.omega + share.omega * difference)


def covariance_with_rate(covariance: TwistCovariance, share: GyroShare) -> TwistCovariance:
    """Return the covariance of a twist after :func:`with_rate`.

    Its error is then independent of the difference, which may therefore be used once more as a measurement of the bias
    of the gyro and of the errors of the wheels.
    """
    var_v, cov, var_omega = covariance
    left = 1.0 - share.omega
    return TwistCovariance(var_v - share.v * cov, left * cov, left * var_omega)


def slip_covariance(difference: float, separation: float) -> TwistCovariance:
    """Return the covariance of a twist whose turn rate is contradicted by ``difference`` [rad/s], since a wheel slips.

    Either wheel may slip, so each rim speed has the variance that explains the difference; ``separation`` is L [m].
    """
    squared, half = difference * difference, 0.5 * separation
    return TwistCovariance(half * half * squared, 0.0, squared)


def bias_of(x: Array) -> float:
    """Return the bias of the gyro [rad/s]; 0 if it is not a state."""
    return float(x[BIAS]) if len(x) > BIAS else 0.0


def corrected_twist(x: Array, motion: Motion, separation: float) -> Twist:
    """Return the twist of a motion, corrected by the errors of the wheels in the state ``x`` (n,) and by the gyro."""
    wheels = with_wheel_errors(motion.twist, x, separation)
    share = gyro_share(motion.covariance, motion.rate)
    return with_rate(wheels, motion.rate.value - bias_of(x) - wheels.omega, share)


def move(pose: Pose, twist: Twist, dt: float) -> Pose:
    """Move ``pose`` with ``twist`` for ``dt`` [s] along the midpoint heading theta_m = theta + omega dt / 2.

    x += v dt cos(theta_m), y += v dt sin(theta_m), theta += omega dt: second order in dt.
    """
    x, y, theta = pose
    middle, distance = theta + 0.5 * twist.omega * dt, twist.v * dt
    return Pose(x + distance * math.cos(middle), y + distance * math.sin(middle), wrap_angle(theta + twist.omega * dt))


def transition(x: Array, motion: Motion, separation: float) -> Moved:
    """Move the state ``x`` (n,); ``separation`` is L [m].

    The derivative of the end of the motion with respect to velocity and turn rate is G = [[x_v, x_w], [y_v, y_w],
    [0, dt]] with x_v = dt cos(theta_m), y_v = dt sin(theta_m), x_w = -v dt y_v / 2 and y_w = v dt x_v / 2. Q is G M G'
    with the covariance M of the twist, plus the part across the robot.
    """
    n, dt = len(x), motion.dt
    twist, share = corrected_twist(x, motion, separation), gyro_share(motion.covariance, motion.rate)
    var_v, cov, var_w = covariance_with_rate(motion.covariance, share)
    theta = float(x[2])
    sine, cosine = math.sin(theta + 0.5 * twist.omega * dt), math.cos(theta + 0.5 * twist.omega * dt)
    x_v, y_v = dt * cosine, dt * sine
    x_w, y_w = -0.5 * dt * twist.v * y_v, 0.5 * dt * twist.v * x_v
    moved = x.copy()
    moved[0] += twist.v * x_v
    moved[1] += twist.v * y_v
    moved[2] = wrap_angle(theta + twist.omega * dt)
    F, Q = np.eye(n), np.zeros((n, n))
    F[0, 2], F[1, 2] = -twist.v * y_v, twist.v * x_v
    Q[0, 0] = x_v * x_v * var_v + 2.0 * x_v * x_w * cov + x_w * x_w * var_w + motion.lateral * sine * sine
    Q[1, 1] = y_v * y_v * var_v + 2.0 * y_v * y_w * cov + y_w * y_w * var_w + motion.lateral * cosine * cosine
    Q[2, 2] = dt * dt * var_w
    Q[0, 1] = Q[1, 0] = (
        x_v * y_v * var_v + (x_v * y_w + y_v * x_w) * cov + x_w * y_w * var_w - motion.lateral * sine * cosine
    )
    Q[0, 2] = Q[2, 0] = dt * (x_v * cov + x_w * var_w)
    Q[1, 2] = Q[2, 1] = dt * (y_v * cov + y_w * var_w)
    if n > WHEELS:
        for i, (wheels_v, wheels_w) in enumerate(_by_wheel_errors(motion.twist, x, separation)):
            v, w = wheels_v - share.v * wheels_w, (1.0 - share.omega) * wheels_w
            F[0, 3 + i], F[1, 3 + i], F[2, 3 + i] = x_v * v + x_w * w, y_v * v + y_w * w, dt * w
    if n > BIAS:
        v, w = -share.v, -share.omega
        F[0, BIAS], F[1, BIAS], F[2, BIAS] = x_v * v + x_w * w, y_v * v + y_w * w, dt * w
    return Moved(moved, F, Q)


def _by_wheel_errors(measured: Twist, x: Array, separation: float) -> tuple[tuple[float, float], ...]:
    """Return the derivatives of velocity and turn rate with respect to the three errors of the wheels."""
    v, omega = measured
    left, right = v - 0.5 * separation * omega, v + 0.5 * separation * omega
    stretch = 1.0 + float(x[5])
    real = separation * stretch
    turn = with_wheel_errors(measured, x, separation).omega
    return (0.5 * left, -left / real), (0.5 * right, right / real), (0.0, -turn / stretch)


def rate_expectation(x: Array, motion: Motion, separation: float) -> RateExpected:
    """Compare the turn rate of a gyro with that of the wheels, which measures the bias and the errors of the wheels.

    The derivatives are taken at the combined twist of wheels and gyro, whose error is independent of the difference
    between both. At the twist of the wheels alone, derivatives and difference would have a common error with a non-zero
    mean product, so that each correction would make the radii smaller.
    """
    n, share = len(x), gyro_share(motion.covariance, motion.rate)
    wheels = with_wheel_errors(motion.twist, x, separation)
    difference = motion.rate.value - bias_of(x) - wheels.omega
    H = np.zeros((1, n))
    by = _by_wheel_errors(with_rate(motion.twist, difference, share), x, separation)
    for i, (_, w) in enumerate(by):
        H[0, WHEELS + i] = w
    # The corrected twist already contains the errors.
    H[0, 5] = -with_rate(wheels, difference, share).omega / (1.0 + float(x[5]))
    H[0, BIAS] = 1.0
    return RateExpected(difference, H, motion.rate.variance + motion.covariance.var_omega)


def size_of(kind: int) -> int:
    """Return m, the number of numbers in a measurement of this kind."""
    if kind == POSE_FIX:
        return 3
    return 2 if kind in (POSITION_FIX, LANDMARK) else 1


def is_fix(kind: int) -> bool:
    """True if a measurement of this kind contains the position."""
    return kind in (POSE_FIX, POSITION_FIX)


def is_angle(kind: int, number: int) -> bool:
    """True if this number of a measurement is an angle."""
    return number == (2 if kind == POSE_FIX else 1 if kind == LANDMARK else 0) and kind not in (POSITION_FIX, RANGE)


def is_defined(reading: Reading, x: Array) -> bool:
    """True unless the robot stands at the landmark, where no bearing is defined."""
    if reading.kind < LANDMARK:
        return True
    dx, dy = reading.at.x - float(x[0]), reading.at.y - float(x[1])
    return dx * dx + dy * dy >= MIN_LANDMARK_DISTANCE * MIN_LANDMARK_DISTANCE


def expect(reading: Reading, x: Array, P: Array) -> Expected:
    """Compare a measurement with the state ``x`` (n,) of covariance ``P`` (n, n); it must be defined there."""
    kind, n = reading.kind, len(x)
    if kind >= LANDMARK:
        return _expect_landmark(reading, x, P)
    first, m = 2 if kind == HEADING else 0, size_of(kind)
    y, H = np.empty(m), np.zeros((m, n))
    for i in range(m):
        y[i] = reading.z[i] - x[first + i]
        H[i, first + i] = 1.0
    if first + m == 3:
        y[m - 1] = wrap_angle(float(y[m - 1]))
    return Expected(y, H, reading.R)


def _expect_landmark(reading: Reading, x: Array, P: Array) -> Expected:
    """Compare range and bearing of a landmark, or one of them, with the state.

    The range is (1 + scale) d + offset. Both are linearised at the estimated position. If its uncertainty is not small
    compared with the distance d, the second-order terms matter: t^2 / (2 d) and t l / d^2 for errors l along the line
    of sight and t across it. P_xx + P_yy bounds the variances of both errors.
    """
    kind, m = reading.kind, size_of(reading.kind)
    dx, dy = reading.at.x - float(x[0]), reading.at.y - float(x[1])
    squared = dx * dx + dy * dy
    distance, spread = math.sqrt(squared), float(P[0, 0]) + float(P[1, 1])
    y, H, R = np.empty(m), np.zeros((m, len(x))), reading.R.copy()
    if kind != BEARING:
        stretch = 1.0 + float(x[SENSOR + 1])
        y[0] = reading.z[0] - (stretch * distance + float(x[SENSOR]))
        H[0, 0], H[0, 1] = -stretch * dx / distance, -stretch * dy / distance
        H[0, SENSOR], H[0, SENSOR + 1] = 1.0, distance
        R[0, 0] += stretch * stretch * spread * spread / (2.0 * squared)
    if kind != RANGE:
        i = m - 1
        y[i] = wrap_angle(float(reading.z[i]) - (math.atan2(dy, dx) - float(x[2]) + float(x[SENSOR + 2])))
        H[i, 0], H[i, 1], H[i, 2], H[i, SENSOR + 2] = dy / squared, -dx / squared, -1.0, 1.0
        R[i, i] += spread * spread / (squared * squared)
    return Expected(y, H, R)


def arc_correction(dx: float, dy: float, turn: float) -> tuple[float, float]:
    """Return a correction of x and y along an arc that turns by ``turn`` [rad]: V(turn) (dx, dy).

    V is the left Jacobian of SE(2). Together with the position's part of P turned by ``turn``, this is the invariant
    extended Kalman filter (Barrau and Bonnabel 2017): with an uncertain heading, the error of the position is spread
    along an arc, not along a straight line.
    """
    if abs(turn) < 1e-9:
        return dx, dy
    a, b = math.sin(turn) / turn, (1.0 - math.cos(turn)) / turn
    return a * dx - b * dy, b * dx + a * dy
