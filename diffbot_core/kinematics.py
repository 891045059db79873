"""Kinematics of the differential drive: wheel speeds and the twist of the body."""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from diffbot_core.schema import WHEEL_SIZE, Spec, known_fields

RESTING_SIGMA = 1e-3
"""[rad/s] Standard deviation of a wheel speed at rest: no encoder is exact, and a filter needs some noise."""


class Twist(NamedTuple):
    """Velocity of the body in its own frame."""

    v: float
    """[m/s] forward; negative when the robot reverses"""
    omega: float
    """[rad/s] counter-clockwise"""


STOP = Twist(0.0, 0.0)
"""Command that stops the robot."""


class TwistCovariance(NamedTuple):
    """Covariance of a measured twist. In a message, an all-zero covariance means *unknown*, not *exact*."""

    var_v: float
    """[m^2/s^2]"""
    cov_v_omega: float
    """[m rad/s^2]"""
    var_omega: float
    """[rad^2/s^2]"""


class WheelSpeeds(NamedTuple):
    """Angular speeds of both wheels [rad/s], positive when the wheel rolls forward."""

    left: float
    right: float


@known_fields
class WheelGeometry(NamedTuple):
    """R and L of the paper (section 4.1), which calls R a diameter and uses it as the radius."""

    wheel_radius: Annotated[float, Spec("wheel radius R", "m", *WHEEL_SIZE)] = 0.05
    wheel_separation: Annotated[float, Spec("distance of the wheels L", "m", *WHEEL_SIZE)] = 0.6


def wheel_speeds(twist: Twist, geometry: WheelGeometry) -> WheelSpeeds:
    """Return the wheel speeds [rad/s] for a ``twist`` (inverse kinematics)."""
    turn = 0.5 * twist.omega * geometry.wheel_separation
    return WheelSpeeds((twist.v - turn) / geometry.wheel_radius, (twist.v + turn) / geometry.wheel_radius)


def body_twist(wheels: WheelSpeeds, geometry: WheelGeometry) -> Twist:
    """Return v = R (wL + wR) / 2 and omega = R (wR - wL) / L, the forward kinematics (paper, section 2.1)."""
    radius = geometry.wheel_radius
    return Twist(
        0.5 * radius * (wheels.left + wheels.right),
        radius * (wheels.right - wheels.left) / geometry.wheel_separation,
    )


def twist_covariance(sigma_left: float, sigma_right: float, geometry: WheelGeometry) -> TwistCovariance:
    """Return the covariance of the twist for independent errors of the wheel speeds with these sigmas [rad/s]."""
    radius, separation = geometry.wheel_radius, geometry.wheel_separation
    left, right = sigma_left * sigma_left, sigma_right * sigma_right
    return TwistCovariance(
        0.25 * radius**2 * (left + right),
        0.5 * radius**2 / separation * (right - left),
        radius**2 / separation**2 * (left + right),
    )


def add_twist_covariance(a: TwistCovariance, b: TwistCovariance) -> TwistCovariance:
    """Return the covariance of the sum of two independent errors."""
    return TwistCovariance(a.var_v + b.var_v, a.cov_v_omega + b.cov_v_omega, a.var_omega + b.var_omega)


def scale_twist_covariance(covariance: TwistCovariance, factor: float) -> TwistCovariance:
    """Multiply all entries by ``factor``."""
    var_v, cov, var_omega = covariance
    return TwistCovariance(factor * var_v, factor * cov, factor * var_omega)


def encoder_covariance(wheels: WheelSpeeds, bound: float, geometry: WheelGeometry) -> TwistCovariance:
    """Return the covariance of the twist for uniform relative errors of the wheel speeds of at most ``bound``.

    The standard deviation of a wheel speed w is bound |w| / sqrt(3), and RESTING_SIGMA at rest.
    """
    share = bound / math.sqrt(3.0)
    return twist_covariance(
        math.hypot(share * wheels.left, RESTING_SIGMA),
        math.hypot(share * wheels.right, RESTING_SIGMA),
        geometry,
    )
