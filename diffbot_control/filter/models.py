"""Models of the filter: motion and expected measurements, with their derivatives.

The state has n = 3, 6, 7 or 10 numbers, see :func:`state_size`: x, y [m] and theta [rad] in the frame of the fixes; the
relative errors of the left wheel radius, the right wheel radius and the wheel separation; the gyro bias [rad/s]; the
offset [m] and the scale error [-] of the ranges to landmarks, and the offset [rad] of their bearings.

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
"""Indices of the first wheel error, of the gyro bias, and of the first error of the landmark sensor in the state."""
POSE_FIX, POSITION_FIX, HEADING, LANDMARK, RANGE, BEARING = 0, 1, 2, 3, 4, 5
"""Kinds of measurements; a landmark is measured by range and bearing or by one of them."""
UNKNOWN_HEADING = math.pi**2
"""[rad^2] Variance of an unknown heading."""
MAX_SLIP = 0.2
"""Largest relative radius error by which the filter explains slip."""
MIN_LANDMARK_DISTANCE = 1e-3
"""[m] Measurements of nearer landmarks are ignored, since their bearing is not defined."""


class TurnRate(NamedTuple):
    """Mean turn rate over the duration of a motion, measured by a gyro."""

    value: float
    """[rad/s]"""
    variance: float
    """[rad^2/s^2] variance of the mean; inf: not measured"""


NO_RATE = TurnRate(0.0, math.inf)


class Motion(NamedTuple):
    """Mean twist over a duration: the input of the prediction."""

    twist: Twist
    """twist according to the configured wheel radii and separation"""
    dt: float
    """[s]"""
    covariance: TwistCovariance
    rate: TurnRate = NO_RATE
    """turn rate measured by a gyro over the same duration"""
    lateral: float = 0.0
    """[m^2] variance of the sideways motion"""


class Reading(NamedTuple):
    """One measurement as numbers, for the functions of :mod:`ekf`."""

    kind: int
    """POSE_FIX, POSITION_FIX, HEADING, LANDMARK, RANGE or BEARING"""
    source: int
    """row of the source in the noise statistics"""
    place: int
    """row of the previous measurement of the same source or landmark, whose error may be correlated with this error"""
    time: float
    """[s] time of the measurement, relative to any fixed time"""
    z: Any
    """(m,) array of the measured numbers [m], [rad]"""
    R: Any
    """(m, m) array, covariance of ``z``"""
    at: Point = Point(0.0, 0.0)
    """position of the landmark [m]"""


class GyroShare(NamedTuple):
    """Change of the twist per rad/s of difference between the turn rates of gyro and wheels."""

    v: float
    """[m]"""
    omega: float
    """[-]"""


class Moved(NamedTuple):
    """Predicted state."""

    x: Any
    """(n,) array, predicted mean"""
    F: Any
    """(n, n) array, derivative of the predicted mean with respect to the mean before the motion"""
    Q: Any
    """(n, n) array, process noise"""


class Expected(NamedTuple):
    """A measurement compared with its expected value."""

    y: Any
    """(m,) array, innovation: measured minus expected numbers; angles are wrapped"""
    H: Any
    """(m, n) array, derivative of the expected numbers with respect to the state"""
    R: Any
    """(m, m) array, covariance of the measurement plus variance of the linearisation error"""


class RateExpected(NamedTuple):
    """Turn rate of a gyro compared with the turn rate of the wheels."""

    y: float
    """[rad/s] innovation: measured minus expected turn rate"""
    H: Any
    """(1, n) array, derivative of the expected turn rate with respect to the state"""
    variance: float
    """[rad^2/s^2] sum of the variances of gyro and wheels"""


def state_size(calibrating: bool, gyro: bool, landmarks: bool) -> int:
    """Return the number of states n of a filter.

    Args:
        calibrating: the filter estimates the wheel errors.
        gyro: the filter estimates the gyro bias.
        landmarks: the filter estimates the errors of the landmark sensor.

    An error that is not estimated, but precedes an estimated error in the state, has the variance 0.
    """
    if landmarks:
        return 10
    if gyro:
        return 7
    return 6 if calibrating else 3


def with_wheel_errors(twist: Twist, x: Array, separation: float) -> Twist:
    """Return the twist corrected by the wheel errors in the state ``x`` (n,); ``separation`` is L [m].

    With the rim speeds v_l and v_r, the corrected velocity is v + (v_l e_l + v_r e_r) / 2, and the corrected turn rate
    is (omega + (v_r e_r - v_l e_l) / L) / (1 + e_s).
    """
    if len(x) <= WHEELS:
        return twist
    v, omega = twist
    left, right = (v - 0.5 * separation * omega) * float(x[3]), (v + 0.5 * separation * omega) * float(x[4])
    return Twist(v + 0.5 * (left + right), (omega + (right - left) / separation) / (1.0 + float(x[5])))


def gyro_share(covariance: TwistCovariance, rate: TurnRate) -> GyroShare:
    """Return the gain of the correction of a twist by the turn rate of a gyro; 0 without a gyro."""
    total = covariance.var_omega + rate.variance
    return GyroShare(covariance.cov_v_omega / total, covariance.var_omega / total)


def with_rate(twist: Twist, difference: float, share: GyroShare) -> Twist:
    """Return a twist corrected by the ``difference`` [rad/s] between the turn rate of the gyro and of the twist."""
    return Twist(twist.v + share.v * difference, twist.omega + share.omega * difference)


def covariance_with_rate(covariance: TwistCovariance, share: GyroShare) -> TwistCovariance:
    """Return the covariance of a twist after :func:`with_rate`.

    The error of the corrected twist is independent of the difference between gyro and wheels. The difference can
    therefore be used a second time, as a measurement of the gyro bias and the wheel errors.
    """
    var_v, cov, var_omega = covariance
    rest = 1.0 - share.omega
    return TwistCovariance(var_v - share.v * cov, rest * cov, rest * var_omega)


def slip_covariance(difference: float, separation: float) -> TwistCovariance:
    """Return the covariance that slip of a wheel adds to a twist.

    Either wheel may slip, so each rim speed gets the variance that explains the difference.

    Args:
        difference: turn rate of the gyro minus turn rate of the wheels [rad/s].
        separation: wheel separation L [m].
    """
    squared, half = difference * difference, 0.5 * separation
    return TwistCovariance(half * half * squared, 0.0, squared)


def bias_of(x: Array) -> float:
    """Return the gyro bias [rad/s]; 0 if it is not a state."""
    return float(x[BIAS]) if len(x) > BIAS else 0.0


def corrected_twist(x: Array, motion: Motion, separation: float) -> Twist:
    """Return the twist of a motion, corrected by the wheel errors in the state ``x`` (n,) and by the gyro."""
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
    """Predict the state ``x`` (n,) after a motion; ``separation`` is L [m].

    The derivative of the end pose with respect to velocity and turn rate is G = [[x_v, x_w], [y_v, y_w], [0, dt]] with
    x_v = dt cos(theta_m), y_v = dt sin(theta_m), x_w = -v dt y_v / 2 and y_w = v dt x_v / 2. Q is G M G' for the
    covariance M of the twist, plus the variance of the sideways motion.
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
        for i, (v_i, w_i) in enumerate(_wheel_error_derivatives(motion.twist, x, separation)):
            v, w = v_i - share.v * w_i, (1.0 - share.omega) * w_i
            F[0, 3 + i], F[1, 3 + i], F[2, 3 + i] = x_v * v + x_w * w, y_v * v + y_w * w, dt * w
    if n > BIAS:
        v, w = -share.v, -share.omega
        F[0, BIAS], F[1, BIAS], F[2, BIAS] = x_v * v + x_w * w, y_v * v + y_w * w, dt * w
    return Moved(moved, F, Q)


def _wheel_error_derivatives(measured: Twist, x: Array, separation: float) -> tuple[tuple[float, float], ...]:
    """Return the derivatives of velocity and turn rate with respect to each of the three wheel errors."""
    v, omega = measured
    left, right = v - 0.5 * separation * omega, v + 0.5 * separation * omega
    scale = 1.0 + float(x[5])
    true_separation = separation * scale
    turn = with_wheel_errors(measured, x, separation).omega
    return (0.5 * left, -left / true_separation), (0.5 * right, right / true_separation), (0.0, -turn / scale)


def rate_expectation(x: Array, motion: Motion, separation: float) -> RateExpected:
    """Compare the turn rates of gyro and wheels; their difference measures the gyro bias and the wheel errors.

    The derivatives are evaluated at the combined twist of wheels and gyro, whose error is independent of the
    difference. At the twist of the wheels alone, the errors of derivatives and difference would be correlated, and each
    correction would decrease the radii.
    """
    n, share = len(x), gyro_share(motion.covariance, motion.rate)
    wheels = with_wheel_errors(motion.twist, x, separation)
    difference = motion.rate.value - bias_of(x) - wheels.omega
    H = np.zeros((1, n))
    for i, (_, w) in enumerate(_wheel_error_derivatives(with_rate(motion.twist, difference, share), x, separation)):
        H[0, WHEELS + i] = w
    # ``wheels`` already contains the wheel errors.
    H[0, 5] = -with_rate(wheels, difference, share).omega / (1.0 + float(x[5]))
    H[0, BIAS] = 1.0
    return RateExpected(difference, H, motion.rate.variance + motion.covariance.var_omega)


def size_of(kind: int) -> int:
    """Return m, the number of scalars in a measurement of this kind."""
    if kind == POSE_FIX:
        return 3
    return 2 if kind in (POSITION_FIX, LANDMARK) else 1


def is_fix(kind: int) -> bool:
    """True for POSE_FIX and POSITION_FIX."""
    return kind in (POSE_FIX, POSITION_FIX)


def is_angle(kind: int, index: int) -> bool:
    """True if the scalar with this index in a measurement is an angle."""
    return index == (2 if kind == POSE_FIX else 1 if kind == LANDMARK else 0) and kind not in (POSITION_FIX, RANGE)


def is_defined(reading: Reading, x: Array) -> bool:
    """True unless the estimated position is at the landmark, where the bearing is not defined."""
    if reading.kind < LANDMARK:
        return True
    dx, dy = reading.at.x - float(x[0]), reading.at.y - float(x[1])
    return dx * dx + dy * dy >= MIN_LANDMARK_DISTANCE * MIN_LANDMARK_DISTANCE


def expect(reading: Reading, x: Array, P: Array) -> Expected:
    """Compare a measurement with the state ``x`` (n,) of covariance ``P`` (n, n); see :func:`is_defined`."""
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

    The expected range is (1 + scale) d + offset for a landmark at distance d. R is increased by the variance of the
    linearisation error, which matters if the position is uncertain. For position errors l along the line of sight and t
    across it, the second-order terms are t^2 / (2 d) and t l / d^2. P_xx + P_yy bounds the variances of l and t.
    """
    kind, m = reading.kind, size_of(reading.kind)
    dx, dy = reading.at.x - float(x[0]), reading.at.y - float(x[1])
    squared = dx * dx + dy * dy
    distance, spread = math.sqrt(squared), float(P[0, 0]) + float(P[1, 1])
    y, H, R = np.empty(m), np.zeros((m, len(x))), reading.R.copy()
    if kind != BEARING:
        scale = 1.0 + float(x[SENSOR + 1])
        y[0] = reading.z[0] - (scale * distance + float(x[SENSOR]))
        H[0, 0], H[0, 1] = -scale * dx / distance, -scale * dy / distance
        H[0, SENSOR], H[0, SENSOR + 1] = 1.0, distance
        R[0, 0] += scale * scale * spread * spread / (2.0 * squared)
    if kind != RANGE:
        i = m - 1
        y[i] = wrap_angle(float(reading.z[i]) - (math.atan2(dy, dx) - float(x[2]) + float(x[SENSOR + 2])))
        H[i, 0], H[i, 1], H[i, 2], H[i, SENSOR + 2] = dy / squared, -dx / squared, -1.0, 1.0
        R[i, i] += spread * spread / (squared * squared)
    return Expected(y, H, R)


def arc_correction(dx: float, dy: float, turn: float) -> tuple[float, float]:
    """Return the correction V(turn) (dx, dy) of x and y along an arc that turns by ``turn`` [rad].

    V is the left Jacobian of SE(2). If the heading is uncertain, the error of the position is spread along an arc, not
    along a straight line. Together with the rotation of P by ``turn``, this is the invariant extended Kalman filter
    (Barrau and Bonnabel 2017).
    """
    if abs(turn) < 1e-9:
        return dx, dy
    a, b = math.sin(turn) / turn, (1.0 - math.cos(turn)) / turn
    return a * dx - b * dy, b * dx + a * dy
