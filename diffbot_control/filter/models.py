"""Models of the filter: motion along a midpoint arc, and the innovations of pose fixes, headings and landmarks.

Each formula stands here once. All functions are pure and take floats and records of floats: filterpy's filter
(:mod:`diffbot_control.filter.ekf`) calls them, and the compiled filter of the simulation is compiled from them.
Derivatives are named after both variables: ``x_v`` is d x / d v.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from diffbot_core.geometry import Point, Pose, range_and_bearing, wrap_angle
from diffbot_core.kinematics import Twist, TwistCovariance

MIN_LANDMARK_DISTANCE = 1e-3
"""[m] The bearing of a landmark that is nearer carries no information."""


TURNED_VARIANCE = 0.04
"""[rad^2] Heading variance from which a correction is applied along an arc; below, both forms agree in first order."""


class TurnRate(NamedTuple):
    """Mean turn rate over a time, measured by a gyro."""

    value: float
    """[rad/s]"""
    variance: float
    """[rad^2/s^2] of the mean; inf: not measured"""


NO_RATE = TurnRate(0.0, math.inf)


class Motion(NamedTuple):
    """Mean twist over a time with its covariance: the filter's input u."""

    twist: Twist
    dt: float
    """[s]"""
    covariance: TwistCovariance
    rate: TurnRate = NO_RATE
    """of a gyro over the same time"""


class WheelErrors(NamedTuple):
    """Relative errors of the wheels [-]: a real radius or distance is (1 + error) times the configured one."""

    left: float
    """of the radius"""
    right: float
    separation: float
    """of the distance of the wheels"""


class Arc(NamedTuple):
    """End of a motion and its derivatives by the velocity and the heading at the start."""

    end: Pose
    x_v: float
    """[s] dt times the cosine of the midpoint heading"""
    y_v: float
    """[s]"""
    x_theta: float
    """[m/rad]"""
    y_theta: float
    """[m/rad]"""


class MotionNoise(NamedTuple):
    """Upper triangle of the process noise Q of a pose (x, y, theta) [m, m, rad]."""

    xx: float
    xy: float
    xt: float
    yy: float
    yt: float
    tt: float


class TwistDerivatives(NamedTuple):
    """Derivatives of the corrected twist by the relative errors of the wheels [m/s], [rad/s]; the others are zero."""

    v_left: float
    v_right: float
    omega_left: float
    omega_right: float
    omega_separation: float


class GyroShare(NamedTuple):
    """By what the twist changes for each rad/s that a gyro measures beyond the wheels."""

    v: float
    """[m]"""
    omega: float
    """[-]"""


class LandmarkExpectation(NamedTuple):
    """Expected range and bearing of a landmark, their derivatives, and the variances that linearising adds.

    By the heading the range has the derivative 0 and the bearing -1.
    """

    range: float
    """[m]"""
    bearing: float
    """[rad] in (-pi, pi]"""
    range_x: float
    range_y: float
    bearing_x: float
    """[rad/m]"""
    bearing_y: float
    """[rad/m]"""
    added_var_range: float
    """[m^2]"""
    added_var_bearing: float
    """[rad^2]"""


def move(pose: Pose, twist: Twist, dt: float) -> Arc:
    """Move ``pose`` with ``twist`` for ``dt`` [s] along the midpoint heading theta_m = theta + omega dt / 2.

    x += v dt cos(theta_m), y += v dt sin(theta_m), theta += omega dt: second order in dt.
    """
    x, y, theta = pose
    v, omega = twist
    middle = theta + 0.5 * omega * dt
    x_v, y_v = dt * math.cos(middle), dt * math.sin(middle)
    end = Pose(x + v * x_v, y + v * y_v, wrap_angle(theta + omega * dt))
    return Arc(end, x_v, y_v, -v * y_v, v * x_v)


def motion_noise(arc: Arc, v: float, dt: float, covariance: TwistCovariance) -> MotionNoise:
    """Covariance of a pose moved by an uncertain twist: Q = G M G'.

    G = d (x, y, theta) / d (v, omega) = [[x_v, x_omega], [y_v, y_omega], [0, dt]] with x_omega = -v dt y_v / 2 and
    y_omega = v dt x_v / 2. Written out: numpy needs five times as long for matrices so small.

    Args:
        arc: the motion.
        v: its velocity [m/s].
        dt: its duration [s].
        covariance: M, the covariance of the twist.
    """
    var_v, cov, var_omega = covariance
    x_v, y_v = arc.x_v, arc.y_v
    x_omega, y_omega = -0.5 * dt * v * y_v, 0.5 * dt * v * x_v
    return MotionNoise(
        x_v * x_v * var_v + 2.0 * x_v * x_omega * cov + x_omega * x_omega * var_omega,
        x_v * y_v * var_v + (x_v * y_omega + y_v * x_omega) * cov + x_omega * y_omega * var_omega,
        dt * (x_v * cov + x_omega * var_omega),
        y_v * y_v * var_v + 2.0 * y_v * y_omega * cov + y_omega * y_omega * var_omega,
        dt * (y_v * cov + y_omega * var_omega),
        dt * dt * var_omega,
    )


def lateral_noise(arc: Arc, dt: float, variance: float) -> tuple[float, float, float]:
    """Return what a motion across the robot of this ``variance`` [m^2] adds to the xx, xy and yy of Q [m^2]."""
    sine, cosine = arc.y_v / dt, arc.x_v / dt
    return variance * sine * sine, -variance * sine * cosine, variance * cosine * cosine


def _rim_speeds(twist: Twist, separation: float) -> tuple[float, float]:
    """Return v - omega L / 2 and v + omega L / 2 [m/s]; ``separation`` is L [m]."""
    v, omega = twist
    return v - 0.5 * separation * omega, v + 0.5 * separation * omega


def with_wheel_errors(twist: Twist, errors: WheelErrors, separation: float) -> Twist:
    """Return the twist of wheels that differ by ``errors`` from those that ``twist`` was computed for.

    With the rim speeds v_l and v_r: v + (v_l e_l + v_r e_r) / 2 and (omega + (v_r e_r - v_l e_l) / L) / (1 + e_s);
    ``separation`` is L [m].
    """
    rim_left, rim_right = _rim_speeds(twist, separation)
    left, right, error = errors
    omega = twist.omega + (rim_right * right - rim_left * left) / separation
    return Twist(twist.v + 0.5 * (rim_left * left + rim_right * right), omega / (1.0 + error))


def twist_derivatives(measured: Twist, omega: float, separation: float, error: float) -> TwistDerivatives:
    """Derivatives of the corrected twist by the errors of the wheels.

    Args:
        measured: the twist for wheels of the configured size.
        omega: the corrected turn rate [rad/s].
        separation: configured distance of the wheels [m].
        error: relative error of that distance.
    """
    rim_left, rim_right = _rim_speeds(measured, separation)
    real = separation * (1.0 + error)
    return TwistDerivatives(0.5 * rim_left, 0.5 * rim_right, -rim_left / real, rim_right / real, -omega / (1.0 + error))


def pose_derivatives(arc: Arc, dt: float, v: float, omega: float) -> tuple[float, float, float]:
    """Derivatives of the end of ``arc`` by what its twist has the derivatives ``v`` and ``omega`` by."""
    _, x_v, y_v, x_theta, y_theta = arc
    theta = dt * omega
    # The midpoint heading turns by half of what the heading turns by.
    return x_v * v + 0.5 * x_theta * theta, y_v * v + 0.5 * y_theta * theta, theta


def gyro_share(covariance: TwistCovariance, rate: TurnRate) -> GyroShare:
    """Return the gain of a turn rate on a twist of this ``covariance``; zero for one that was not measured."""
    _, cov, var_omega = covariance
    total = var_omega + rate.variance
    return GyroShare(cov / total, var_omega / total)


def derivatives_with_rate(v: float, omega: float, share: GyroShare) -> tuple[float, float]:
    """Derivatives of a twist after :func:`with_rate`, by what it had the derivatives ``v`` and ``omega`` by before."""
    return v - share.v * omega, (1.0 - share.omega) * omega


def slip_covariance(difference: float, separation: float) -> TwistCovariance:
    """Return the covariance of a twist whose turn rate is contradicted by ``difference`` [rad/s]: a wheel slips.

    Either may, so each rim speed has the variance that explains the difference; ``separation`` is L [m].
    """
    squared, half = difference * difference, 0.5 * separation
    return TwistCovariance(half * half * squared, 0.0, squared)


def with_rate(twist: Twist, difference: float, share: GyroShare) -> Twist:
    """Return a twist corrected by the ``difference`` [rad/s] between the gyro's turn rate and its own."""
    return Twist(twist.v + share.v * difference, twist.omega + share.omega * difference)


def rate_derivatives(
    measured: Twist, corrected: Twist, difference: float, share: GyroShare, separation: float, error: float
) -> TwistDerivatives:
    """Derivatives by the errors of the wheels where a gyro measures the turn rate, too.

    They are taken at the twist of wheels and gyro together, whose error is independent of the ``difference`` between
    both [rad/s]. Those at the twist of the wheels alone have the error of the difference in them. The product of both
    has a mean, and each correction by the difference would make the radii smaller.

    Args:
        measured: by wheels of the configured size.
        corrected: the same for wheels with the estimated errors.
        difference: between the gyro's turn rate, without its bias, and the corrected one.
        share: of the gyro.
        separation: configured distance of the wheels [m].
        error: relative error of that distance.
    """
    omega = with_rate(corrected, difference, share).omega
    return twist_derivatives(with_rate(measured, difference, share), omega, separation, error)


def covariance_with_rate(covariance: TwistCovariance, share: GyroShare) -> TwistCovariance:
    """Return the covariance of a twist after :func:`with_rate`.

    Its error is then independent of the difference, which may therefore be used once more as a measurement of the bias
    of the gyro and of the errors of the wheels.
    """
    var_v, cov, var_omega = covariance
    left = 1.0 - share.omega
    return TwistCovariance(var_v - share.v * cov, left * cov, left * var_omega)


def heading_innovation(measured: float, theta: float) -> float:
    """Measured minus expected heading [rad], the short way round."""
    return wrap_angle(measured - theta)


def pose_innovation(measured: Pose, expected: Pose) -> Pose:
    """Measured minus expected pose, the short way round in heading."""
    x, y, theta = measured
    return Pose(x - expected.x, y - expected.y, heading_innovation(theta, expected.theta))


def arc_correction(dx: float, dy: float, turn: float) -> tuple[float, float]:
    """Return what a correction of x and y becomes along an arc that turns by ``turn`` [rad]: V(turn) (dx, dy).

    V is the left Jacobian of SE(2). Together with the position's part of P turned by ``turn``, this is the invariant
    extended Kalman filter (Barrau and Bonnabel 2017): with an uncertain heading, the error of the position is spread
    along an arc, not along a straight line.
    """
    if abs(turn) < 1e-9:
        return dx, dy
    a, b = math.sin(turn) / turn, (1.0 - math.cos(turn)) / turn
    return a * dx - b * dy, b * dx + a * dy


def is_at_landmark(pose: Pose, landmark: Point) -> bool:
    """True if the position is so near to the landmark that no bearing is defined."""
    dx, dy = landmark.x - pose.x, landmark.y - pose.y
    return dx * dx + dy * dy < MIN_LANDMARK_DISTANCE * MIN_LANDMARK_DISTANCE


def expect_landmark(pose: Pose, landmark: Point, spread: float) -> LandmarkExpectation:
    """Expected measurement of ``landmark`` from ``pose``.

    Args:
        pose: estimate, not at the landmark (see :func:`is_at_landmark`).
        landmark: its position [m].
        spread: P_xx + P_yy [m^2] of the estimate.
    """
    dx, dy = landmark.x - pose.x, landmark.y - pose.y
    squared = dx * dx + dy * dy
    distance, bearing = range_and_bearing(pose.x, pose.y, pose.theta, landmark.x, landmark.y)
    by_range, by_bearing = linearisation_variance(squared, spread)
    return LandmarkExpectation(
        distance,
        wrap_angle(bearing),
        -dx / distance,
        -dy / distance,
        dy / squared,
        -dx / squared,
        by_range,
        by_bearing,
    )


def linearisation_variance(squared: float, spread: float) -> tuple[float, float]:
    """Added variance for the linearisation error of a range [m^2] and a bearing [rad^2].

    Range and bearing are linearised at the estimated position. If its uncertainty is not small against the distance d
    of the landmark, the second-order terms count: t^2 / (2 d) and t l / d^2 for position errors l along the line of
    sight and t across it.

    Args:
        squared: d^2 [m^2], taken at the estimated position.
        spread: P_xx + P_yy [m^2], an upper bound of the variances of both l and t.
    """
    return spread * spread / (2.0 * squared), spread * spread / (squared * squared)
