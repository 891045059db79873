"""The motion that odometry measures: its noise, its dead time, its gaps, and the motion before the first fix.

Errors of real odometry (slip, a wrong scale, a command in place of a measurement) last longer than one message. With
an independent error in each message, the path of one second has a tenth of the variance at 100 Hz that it has at 10 Hz.
With a density, the variance is the same at any rate. If the twist is a command, it acts later than its stamp says.
"""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

import numpy as np

from diffbot_control.filter.models import Array
from diffbot_core.errors import BadMessageError
from diffbot_core.kinematics import Twist, TwistCovariance, scale_twist_covariance
from diffbot_core.schema import Spec, known_fields
from diffbot_core.stamps import NS_PER_S, S_PER_NS

MESSAGE, MOTION = "message", "motion"
_MAX_DENSITY = 100.0
"""[m^2/s], [rad^2/s], or per metre or radian. With this density the pose is unknown after a second."""


class OdometryStep(NamedTuple):
    """Mean twist since the previous odometry."""

    stamp: int
    """[ns] end of the interval"""
    twist: Twist
    covariance: TwistCovariance
    """all zero: unknown"""


@known_fields
class OdometryConfig(NamedTuple):
    """Noise and dead time of the odometry.

    alpha1 to alpha3 have the letters of AMCL, but are variances per radian or metre of one motion: AMCL multiplies by
    the *square* of the distance between two updates, and so depends on the rate.
    """

    odometry_noise: Annotated[
        str,
        Spec(
            "noise of the odometry. message: the covariance of each message, with independent errors; "
            "motion: alpha1 .. density_theta. Messages without covariance always use motion",
            choices=(MESSAGE, MOTION),
        ),
    ] = MESSAGE
    odometry_covariance_scale: Annotated[
        float,
        Spec("factor on the covariance of each odometry message", minimum=1e-6, maximum=1e6),
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


class Densities(NamedTuple):
    """Arguments of :func:`motion_noise`, with the meaning that they have in :class:`OdometryConfig`."""

    alpha1: float
    alpha2: float
    alpha3: float
    density_xy: float
    density_theta: float


def densities_of(config: OdometryConfig) -> Densities:
    """Return the densities of a configuration."""
    return Densities(config.alpha1, config.alpha2, config.alpha3, config.density_xy, config.density_theta)


def motion_noise(twist: Twist, dt: float, densities: Densities) -> tuple[TwistCovariance, float]:
    """Return the covariance of a mean twist over ``dt`` [s], and the variance of the motion across the robot [m^2].

    The mean of white noise of density S over dt has the variance S / dt. The densities are linear in |v| and |omega|.
    While the robot drives with v, the growing error of the heading moves it across by a variance of v^2 S_theta dt^3 /
    3. The model of a constant twist contains v^2 S_theta dt^3 / 4 of this variance. The rest is added here, so that the
    noise of a motion is the same in one step or in many.
    """
    speed, turn = abs(twist.v), abs(twist.omega)
    along = densities.alpha3 * speed + densities.density_xy
    heading = densities.alpha1 * turn + densities.alpha2 * speed + densities.density_theta
    across = densities.density_xy * dt + speed * speed * heading * dt * dt / 12.0 * dt
    return TwistCovariance(along / dt, 0.0, heading / dt), across


def step_noise(
    odometry: OdometryStep, dt: float, share: float, config: OdometryConfig, *, is_gap: bool
) -> tuple[TwistCovariance, float]:
    """Return the same as :func:`motion_noise` over ``dt`` [s], a part of an odometry message or of a gap.

    Args:
        odometry: the message, or the :func:`unknown_motion` in a gap.
        dt: duration of the part [s].
        share: duration of the whole over that of the part. The error of a mean twist is constant over the whole, so the
            variances of the parts must add up to that of the whole.
        config: how the noise is modelled.
        is_gap: the variance is as large across the robot as along it.
    """
    if is_gap:
        covariance = scale_twist_covariance(odometry.covariance, share)
        return covariance, covariance.var_v * dt * dt
    if config.odometry_noise == MESSAGE and any(odometry.covariance):
        return scale_twist_covariance(odometry.covariance, config.odometry_covariance_scale * share), 0.0
    return motion_noise(odometry.twist, dt, densities_of(config))


def unknown_motion(start: int, end: int, before: Twist, after: Twist) -> OdometryStep:
    """Return the motion in a gap from ``start`` to ``end`` [ns]: none, as uncertain as the faster of two twists."""
    v = max(abs(before.v), abs(after.v))
    # With a deviation of pi the heading is unknown.
    omega = min(max(abs(before.omega), abs(after.omega)), math.pi / ((end - start) * S_PER_NS))
    return OdometryStep(end, Twist(0.0, 0.0), TwistCovariance(v * v, 0.0, omega * omega))


class Piece(NamedTuple):
    """A part of an interval in which one twist acts."""

    odometry: OdometryStep
    """the twist, stamped with the end of the part"""
    whole: int
    """[ns] duration of the message that the twist comes from"""


class DelayLine:
    """Delays the twists of the newest odometry messages.

    A message stamped t that follows one stamped s is the mean twist over (s, t]. Delayed by d, it acts over (s + d,
    t + d]. The first twist also acts before that time.
    """

    def __init__(self) -> None:
        """Start empty."""
        self._messages: list[tuple[int, OdometryStep]] = []

    def clear(self) -> None:
        """Drop all messages."""
        self._messages.clear()

    def pieces(self, start: int, odometry: OdometryStep, delay: int) -> list[Piece]:
        """Add a message, and return the twists that move the robot from ``start`` to the stamp of the message.

        Args:
            start: [ns] stamp of the previous message.
            odometry: the new message.
            delay: [ns] >= 0.
        """
        if delay == 0:
            return [Piece(odometry, odometry.stamp - start)]
        self._messages.append((start, odometry))
        found: list[Piece] = []
        for began, message in self._messages:
            end = min(message.stamp + delay, odometry.stamp)
            if end > start:
                found.append(Piece(message._replace(stamp=end), message.stamp - began))
                start = end
        # Drop the messages that have acted to their end, but keep the newest one.
        self._messages = [one for one in self._messages if one[1].stamp + delay > odometry.stamp] or self._messages[-1:]
        return found


class EarlyOdometry:
    """The odometry before the first fix: which fixes may start the filter, and how uncertain an old fix has become."""

    def __init__(self) -> None:
        """Start without a message."""
        self.newest: int | None = None
        """[ns] stamp of the newest message"""
        self._moved = self._turned = 0.0
        """[m], [rad] length of the path since the first message, in any direction"""

    def add(self, odometry: OdometryStep, history: int) -> None:
        """Add a message; a stamp that is behind by more than ``history`` [ns] begins another run."""
        passed = 0 if self.newest is None else odometry.stamp - self.newest
        if passed < -history:
            self._moved = self._turned = 0.0
        elif passed < 0:
            return
        else:
            self._moved += abs(odometry.twist.v) * passed * S_PER_NS
            self._turned += abs(odometry.twist.omega) * passed * S_PER_NS
        self.newest = odometry.stamp

    def start(self, stamp: int, history: int) -> tuple[int, Array]:
        """Return the time [ns] at which a fix stamped ``stamp`` [ns] starts the filter, and the addition (3, 3) to P.

        A fix that is not older than the history [ns] starts the filter at the stamp of the fix. An older one starts it
        at the newest odometry, as uncertain as after an unknown motion of the length of the whole path.

        Raises:
            BadMessageError: if the fix is ahead of the odometry by more than the history, but at least a second.
        """
        late = 0 if self.newest is None else self.newest - stamp
        if -late > max(history, NS_PER_S):
            text = f"by {-late * S_PER_NS:.3f} s: synchronise the clocks that stamp both (chrony)"
            raise BadMessageError("ahead of the odometry", text)
        if late <= history:
            return stamp, np.zeros((3, 3))
        return stamp + late, np.diag(np.square((self._moved, self._moved, self._turned)))
