"""Noise of the odometry as a spectral density, so that it does not depend on the rate of the messages.

Errors of real odometry (slip, a wrong scale, a command in place of a measurement) last longer than a message. A white
error of each message gives the path of one second a tenth of the variance at 100 Hz that it gives at 10 Hz; a density
gives the same at any rate. Pure functions of floats.
"""

from __future__ import annotations

from typing import Annotated, NamedTuple

from diffbot_core.kinematics import Twist, TwistCovariance, scale_twist_covariance
from diffbot_core.schema import Spec, known_fields

MESSAGE, DENSITY, MOTION = "message", "density", "motion"
_MAX_DENSITY = 100.0
"""[m^2/s], [rad^2/s] and per metre or radian: the pose is unknown after a second."""


@known_fields
class OdometryConfig(NamedTuple):
    """Noise and dead time of the odometry.

    alpha1 to alpha4 have the letters of AMCL, but are variances per radian or metre of one motion: AMCL multiplies by
    the *square* of the distance between two updates, and so depends on the rate.
    """

    odometry_noise: Annotated[
        str,
        Spec(
            "what the noise of the odometry is: the covariance of each message, its errors independent from message to "
            "message; the same as a density per second; or alpha1 .. density_theta, also used where a message has none",
            choices=(MESSAGE, DENSITY, MOTION),
        ),
    ] = MESSAGE
    odometry_covariance_scale: Annotated[
        float,
        Spec(
            "factor on the covariance of each odometry message, with odometry_noise message or density",
            minimum=1e-6,
            maximum=1e6,
        ),
    ] = 1.0
    alpha1: Annotated[
        float, Spec("variance of the heading per radian turned", "rad^2/rad", minimum=0.0, maximum=_MAX_DENSITY)
    ] = 0.012
    alpha2: Annotated[
        float, Spec("variance of the heading per metre driven", "rad^2/m", minimum=0.0, maximum=_MAX_DENSITY)
    ] = 0.002
    alpha3: Annotated[
        float, Spec("variance of the distance per metre driven", "m^2/m", minimum=0.0, maximum=_MAX_DENSITY)
    ] = 0.015
    alpha4: Annotated[
        float, Spec("variance of the distance per radian turned", "m^2/rad", minimum=0.0, maximum=_MAX_DENSITY)
    ] = 0.0
    density_xy: Annotated[
        float,
        Spec("variance of the position along and across per second", "m^2/s", minimum=1e-12, maximum=_MAX_DENSITY),
    ] = 1e-6
    density_theta: Annotated[
        float, Spec("variance of the heading per second", "rad^2/s", minimum=1e-12, maximum=_MAX_DENSITY)
    ] = 1e-4
    odometry_delay: Annotated[
        float,
        Spec(
            "dead time: the twist of an odometry message acts this much later than stamped",
            "s",
            minimum=0.0,
            maximum=2.0,
        ),
    ] = 0.0


class MotionDensity(NamedTuple):
    """White noise of the body's velocity, as the variance that it adds per second."""

    twist: TwistCovariance
    """[m^2/s], [m rad/s], [rad^2/s] along the robot, of the heading, and between them"""
    lateral: float
    """[m^2/s] across the robot"""


def motion_density(twist: Twist, config: OdometryConfig) -> MotionDensity:
    """Return the noise of a motion with ``twist``; it is linear in |v| and |omega|."""
    speed, turn = abs(twist.v), abs(twist.omega)
    along = config.alpha3 * speed + config.alpha4 * turn + config.density_xy
    heading = config.alpha1 * turn + config.alpha2 * speed + config.density_theta
    return MotionDensity(TwistCovariance(along, 0.0, heading), config.density_xy)


def density_of(twist: Twist, covariance: TwistCovariance, config: OdometryConfig) -> MotionDensity | None:
    """Return the noise of an odometry message as a density; None if its covariance is that of its mean twist.

    Args:
        twist: of the message.
        covariance: of the message; all zero: unknown.
        config: which of them to use.
    """
    if config.odometry_noise == MESSAGE and any(covariance):
        return None
    if config.odometry_noise == DENSITY and any(covariance):
        return MotionDensity(scale_twist_covariance(covariance, config.odometry_covariance_scale), 0.0)
    return motion_density(twist, config)


def over_time(density: MotionDensity, v: float, dt: float) -> tuple[TwistCovariance, float]:
    """Turn a density into the covariance of the mean twist over ``dt`` [s], and the variance across the robot [m^2].

    White noise of density S has a mean over dt of variance S / dt. While the robot drives with ``v`` [m/s], the error
    of the heading grows from 0 on, which moves it across by a variance of v^2 S_theta dt^3 / 3. The model of a constant
    twist has v^2 S_theta dt^3 / 4 of it; with the rest, the noise of a motion is the same in one step or many.
    """
    (var_v, cov, var_omega), lateral = density
    mean = TwistCovariance(var_v / dt, cov / dt, var_omega / dt)
    return mean, lateral * dt + v * v * var_omega * dt * dt * dt / 12.0
