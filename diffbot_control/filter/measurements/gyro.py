"""The turn rate of a gyro beside that of the wheels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from diffbot_control.filter.measurements.measurement import Array, Measurement, Source, States
from diffbot_control.filter.models import TurnRate, WheelErrors, gyro_share, rate_derivatives, with_wheel_errors
from diffbot_core.kinematics import Twist, TwistCovariance

GYRO = "gyro"
_SOURCE = Source(GYRO)


@dataclass(frozen=True, eq=False)
class GyroRate(Measurement):
    """Mean turn rate over an odometry step, against the twist that the wheels measured over it.

    It says what the bias of the gyro and the errors of the wheels are. What it says of the motion is the prediction's
    part, see :func:`models.covariance_with_rate`; the errors of both parts are independent.
    """

    rate: TurnRate
    wheels: Twist
    """measured twist, for wheels of the configured size"""
    covariance: TwistCovariance
    """of that twist"""
    wheel_separation: float
    """L [m]"""

    @property
    def source(self) -> Source:
        """There is one gyro."""
        return _SOURCE

    @property
    def z(self) -> Array:
        """Turn rate [rad/s]."""
        return np.array((self.rate.value,))

    def expected(self, x: Array, states: States) -> Array:
        """Return the turn rate of the wheels and the bias."""
        return with_wheel_errors(self.wheels, self._errors(x, states), self.wheel_separation).omega + x[states.gyro]

    def jacobian(self, x: Array, states: States) -> Array:
        """Return the derivatives by the errors of the wheels and by the bias."""
        H, part, errors = np.zeros((1, states.size)), states.wheels, self._errors(x, states)
        share = gyro_share(self.covariance, self.rate)
        corrected = with_wheel_errors(self.wheels, errors, self.wheel_separation)
        difference = self.rate.value - corrected.omega - x[states.gyro].item()
        by = rate_derivatives(self.wheels, corrected, difference, share, self.wheel_separation, errors.separation)
        H[0, part] = (by.omega_left, by.omega_right, by.omega_separation)[: part.stop - part.start]
        H[0, states.gyro] = 1.0
        return H

    def noise(self, x: Array, P: Array, states: States) -> Array:
        """Return the variance of the difference."""
        return np.array(((self.rate.variance + self.covariance.var_omega,),))

    def _errors(self, x: Array, states: States) -> WheelErrors:
        """Return the errors of the wheels; 0 where they are no states."""
        found: list[float] = x.tolist()[states.wheels]
        return WheelErrors(*found, *[0.0] * (3 - len(found)))
