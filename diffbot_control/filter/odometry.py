"""Odometry: noise, dead time and gaps, and the motion before the first fix.

The noise of a motion is modelled in one of two ways. With the covariance of each message and independent errors, the
variance of a path is inversely proportional to the rate of the messages. The errors of real odometry, such as
slip or a wrong scale, last longer than one message. With noise densities, the variance of a path does not depend on the
rate.
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
"""[m^2/s], [rad^2/s], or per metre or radian. With this density, the pose is unknown after one second."""


class OdometryStep(NamedTuple):
    """Mean twist since the previous odometry message."""

    stamp: int
    """[ns] end of the interval"""
    twist: Twist
    covariance: TwistCovariance
    """covariance of the mean twist; all zero: unknown"""


@known_fields
class Densities(NamedTuple):
    """Noise densities of the odometry.

    alpha1 to alpha3 are named as in AMCL, but are variances per radian or metre. AMCL multiplies by the *square* of the
    distance between two updates, so its noise depends on the rate of the updates.
    """

    alpha1: Annotated[
        float, Spec("variance of the heading per radian turned", "rad^2/rad", minimum=0.0, maximum=_MAX_DENSITY)
    ] = 0.012
    alpha2: Annotated[
        float, Spec("variance of the heading per metre driven", "rad^2/m", minimum=0.0, maximum=_MAX_DENSITY)
    ] = 0.002
    alpha3: Annotated[
        float, Spec("variance of the driven distance per metre driven", "m^2/m", minimum=0.0, maximum=_MAX_DENSITY)
    ] = 0.015
    density_xy: Annotated[
        float,
        Spec("variance of the position per second, forward and sideways", "m^2/s", minimum=1e-12, maximum=_MAX_DENSITY),
    ] = 1e-6
    density_theta: Annotated[
        float, Spec("variance of the heading per second", "rad^2/s", minimum=1e-12, maximum=_MAX_DENSITY)
    ] = 1e-4


@known_fields
class OdometryConfig(NamedTuple):
    """Noise and dead time of the odometry."""

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
    densities: Densities = Densities()
    odometry_delay: Annotated[
        float,
        Spec(
            "dead time from the stamp of an odometry message until its twist acts",
            "s",
            minimum=0.0,
            maximum=2.0,
        ),
    ] = 0.0


def motion_noise(twist: Twist, dt: float, densities: Densities) -> tuple[TwistCovariance, float]:
    """Return the covariance of a mean twist over ``dt`` [s], and the variance of the sideways motion [m^2].

    The mean of white noise of density S over dt has the variance S / dt. The densities are linear in |v| and |omega|.
    At velocity v, the growing heading error causes a sideways variance of v^2 S_theta dt^3 / 3. The model with a
    constant twist contains v^2 S_theta dt^3 / 4 of this variance. The difference is added here, so that the noise of a
    motion does not depend on the number of its steps.
    """
    speed, turn = abs(twist.v), abs(twist.omega)
    along = densities.alpha3 * speed + densities.density_xy
    heading = densities.alpha1 * turn + densities.alpha2 * speed + densities.density_theta
    across = densities.density_xy * dt + speed * speed * heading * dt * dt / 12.0 * dt
    return TwistCovariance(along / dt, 0.0, heading / dt), across


def step_noise(
    odometry: OdometryStep, dt: float, share: float, config: OdometryConfig, *, is_gap: bool
) -> tuple[TwistCovariance, float]:
    """Return the same as :func:`motion_noise` for a part of an odometry message or of a gap.

    Args:
        odometry: odometry message, or :func:`unknown_motion` in a gap.
        dt: duration of the part [s].
        share: duration of the whole message or gap over the duration of the part. It multiplies the covariance, so that
            the variances of the motions in all parts add up to the variance of the whole motion.
        config: noise of the odometry.
        is_gap: True in a gap, where the sideways variance is as large as the forward variance.
    """
    if is_gap:
        covariance = scale_twist_covariance(odometry.covariance, share)
        return covariance, covariance.var_v * dt * dt
    if config.odometry_noise == MESSAGE and any(odometry.covariance):
        return scale_twist_covariance(odometry.covariance, config.odometry_covariance_scale * share), 0.0
    return motion_noise(odometry.twist, dt, config.densities)


def unknown_motion(start: int, end: int, before: Twist, after: Twist) -> OdometryStep:
    """Return a zero twist for a gap from ``start`` to ``end`` [ns]; its deviation is the faster of two twists."""
    v = max(abs(before.v), abs(after.v))
    # With a deviation of pi the heading is unknown.
    omega = min(max(abs(before.omega), abs(after.omega)), math.pi / ((end - start) * S_PER_NS))
    return OdometryStep(end, Twist(0.0, 0.0), TwistCovariance(v * v, 0.0, omega * omega))


class DelayLine:
    """Delays the twists of the newest odometry messages.

    A message stamped t after a message stamped s is the mean twist over (s, t]. With a delay d, its twist acts over
    (s + d, t + d]. The first twist also acts before s + d.
    """

    def __init__(self) -> None:
        """Start empty."""
        self._messages: list[tuple[int, OdometryStep]] = []
        """start [ns] of each message, and the message"""

    def clear(self) -> None:
        """Drop all messages."""
        self._messages.clear()

    def parts(self, start: int, odometry: OdometryStep, delay: int) -> list[tuple[OdometryStep, int]]:
        """Add a message, and return the twists that act from ``start`` to the stamp of the message.

        Args:
            start: stamp of the previous message [ns].
            odometry: new message.
            delay: delay [ns] >= 0.

        Returns:
            For each part of the interval: its twist, stamped with the end of the part, and the duration [ns] of the
            message with this twist.
        """
        if delay == 0:
            return [(odometry, odometry.stamp - start)]
        self._messages.append((start, odometry))
        parts = []
        for message_start, message in self._messages:
            end = min(message.stamp + delay, odometry.stamp)
            if end > start:
                parts.append((message._replace(stamp=end), message.stamp - message_start))
                start = end
        # Drop the messages that no longer act, but keep the newest one.
        self._messages = [one for one in self._messages if one[1].stamp + delay > odometry.stamp] or self._messages[-1:]
        return parts


class EarlyOdometry:
    """Odometry before the first fix, which determines how uncertain an old first fix is."""

    def __init__(self) -> None:
        """Start without a message."""
        self.newest: int | None = None
        """[ns] stamp of the newest message"""
        self._distance = self._turn = 0.0
        """[m], [rad] total distance and total turn since the first message, in any direction"""

    def add(self, odometry: OdometryStep, history: int) -> None:
        """Add a message. If it is older than the newest message by more than ``history`` [ns], start over with it."""
        elapsed = 0 if self.newest is None else odometry.stamp - self.newest
        if elapsed < -history:
            self._distance = self._turn = 0.0
        elif elapsed < 0:
            return
        else:
            self._distance += abs(odometry.twist.v) * elapsed * S_PER_NS
            self._turn += abs(odometry.twist.omega) * elapsed * S_PER_NS
        self.newest = odometry.stamp

    def start(self, stamp: int, history: int) -> tuple[int, Array]:
        """Return the time [ns] at which a fix starts the filter, and the covariance (3, 3) to add to the fix.

        A fix that is at most ``history`` [ns] older than the newest odometry starts the filter at its own stamp. An
        older fix starts the filter at the newest odometry, and the total distance and turn are added as deviations.

        Raises:
            BadMessageError: if the fix is ahead of the odometry by more than the history and more than 1 s.
        """
        late = 0 if self.newest is None else self.newest - stamp
        if -late > max(history, NS_PER_S):
            text = f"by {-late * S_PER_NS:.3f} s: synchronise the clocks that stamp both (chrony)"
            raise BadMessageError("ahead of the odometry", text)
        if late <= history:
            return stamp, np.zeros((3, 3))
        return stamp + late, np.diag(np.square((self._distance, self._distance, self._turn)))
