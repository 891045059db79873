"""Differential drive: wheel speeds and the body's twist."""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from diffbot_core.schema import Spec

RESTING_SIGMA = 1e-3
"""[rad/s] standard deviation of a wheel speed at rest: no encoder is perfect, and a filter needs some noise."""


class Twist(NamedTuple):
    """Velocity of the body in its own frame."""

    v: float
    """[m/s] along the robot's real forward axis; negative when it reverses"""
    omega: float
    """[rad/s] counter-clockwise"""


class WheelSpeeds(NamedTuple):
    """Angular speeds of the two wheels [rad/s], positive when they roll forward."""

    left: float
    right: float


class WheelGeometry(NamedTuple):
    """R and L of the paper (section 4.1); it calls R a diameter but uses it as the radius."""

    wheel_radius: Annotated[float, Spec("wheel radius R", "m", minimum=0.0, exclusive_minimum=True)] = 0.05
    wheel_separation: Annotated[float, Spec("distance of the wheels L", "m", minimum=0.0, exclusive_minimum=True)] = 0.6


def wheel_speeds(twist: Twist, geometry: WheelGeometry) -> WheelSpeeds:
    """Inverse kinematics: the wheel speeds [rad/s] that move the body with ``twist``."""
    turn = 0.5 * twist.omega * geometry.wheel_separation
    return WheelSpeeds((twist.v - turn) / geometry.wheel_radius, (twist.v + turn) / geometry.wheel_radius)


def body_twist(wheels: WheelSpeeds, geometry: WheelGeometry) -> Twist:
    """Forward kinematics: v = R (wL + wR) / 2, omega = R (wR - wL) / L (paper, section 2.1)."""
    radius = geometry.wheel_radius
    return Twist(
        0.5 * radius * (wheels.left + wheels.right),
        radius * (wheels.right - wheels.left) / geometry.wheel_separation,
    )


def with_radius_errors(twist: Twist, left: float, right: float, separation: float) -> Twist:
    """Return the twist of wheels whose radii are relatively larger by ``left`` and ``right`` than ``twist`` assumes.

    With rim speeds v_l = v - omega L / 2 and v_r = v + omega L / 2: v + (v_l e_l + v_r e_r) / 2 and
    omega + (v_r e_r - v_l e_l) / L; ``separation`` is L [m].
    """
    rim_left, rim_right = twist.v - 0.5 * separation * twist.omega, twist.v + 0.5 * separation * twist.omega
    return Twist(
        twist.v + 0.5 * (rim_left * left + rim_right * right),
        twist.omega + (rim_right * right - rim_left * left) / separation,
    )


def motion_noise(
    ahead_x: float, ahead_y: float, v: float, dt: float, noise: tuple[float, float, float]
) -> tuple[float, float, float, float, float, float]:
    """Covariance of a pose moved by an uncertain twist along the midpoint heading: Q = G M G'.

    G = d (x, y, theta) / d (v, omega) = [[ahead_x, side_x], [ahead_y, side_y], [0, dt]] with side_x = -v dt ahead_y / 2
    and side_y = v dt ahead_x / 2. Written out: numpy needs five times as long for matrices so small.

    Args:
        ahead_x: dt cos of the midpoint heading [s].
        ahead_y: dt sin of it [s].
        v: velocity [m/s].
        dt: duration [s].
        noise: M, the covariance of the twist: var(v), cov(v, omega), var(omega).

    Returns:
        Q_xx, Q_xy, Q_xtheta, Q_yy, Q_ytheta, Q_thetatheta.
    """
    var_v, cov, var_omega = noise
    side_x, side_y = -0.5 * dt * v * ahead_y, 0.5 * dt * v * ahead_x
    return (
        ahead_x * ahead_x * var_v + 2.0 * ahead_x * side_x * cov + side_x * side_x * var_omega,
        ahead_x * ahead_y * var_v + (ahead_x * side_y + ahead_y * side_x) * cov + side_x * side_y * var_omega,
        dt * (ahead_x * cov + side_x * var_omega),
        ahead_y * ahead_y * var_v + 2.0 * ahead_y * side_y * cov + side_y * side_y * var_omega,
        dt * (ahead_y * cov + side_y * var_omega),
        dt * dt * var_omega,
    )


def twist_covariance(sigma_left: float, sigma_right: float, geometry: WheelGeometry) -> tuple[float, float, float]:
    """Propagate independent errors of the wheel speeds, standard deviations [rad/s], to the twist.

    Returns:
        var(v) [m^2/s^2], cov(v, omega) [m rad/s^2], var(omega) [rad^2/s^2].
    """
    radius, separation = geometry.wheel_radius, geometry.wheel_separation
    left, right = sigma_left * sigma_left, sigma_right * sigma_right
    return (
        0.25 * radius**2 * (left + right),
        0.5 * radius**2 / separation * (right - left),
        radius**2 / separation**2 * (left + right),
    )


def encoder_covariance(wheels: WheelSpeeds, bound: float, geometry: WheelGeometry) -> tuple[float, float, float]:
    """Covariance of the twist when each wheel speed has a uniform relative error of at most ``bound``.

    Returns:
        As :func:`twist_covariance`; a wheel has the deviation bound |w| / sqrt(3), and RESTING_SIGMA at rest.
    """
    share = bound / math.sqrt(3.0)
    return twist_covariance(
        math.hypot(share * wheels.left, RESTING_SIGMA),
        math.hypot(share * wheels.right, RESTING_SIGMA),
        geometry,
    )
