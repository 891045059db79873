"""The filter: filterpy's extended Kalman filter for a planar pose, with the models of :mod:`models`.

State ``x = (x, y, theta)`` in the frame of the absolute fixes [m, m, rad], and behind it the constant errors that are
estimated, see :class:`PoseEkf`; letters as in the field: covariance ``P``, transition Jacobian ``F``, process noise
``Q``, measurement Jacobian ``H``, measurement noise ``R``.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter

from diffbot_control.filter.measurements import Array, Innovation, Measurement, States
from diffbot_control.filter.models import (
    TURNED_VARIANCE,
    Arc,
    WheelErrors,
    arc_correction,
    covariance_with_rate,
    derivatives_with_rate,
    gyro_share,
    lateral_noise,
    motion_noise,
    move,
    pose_derivatives,
    twist_derivatives,
    with_rate,
    with_wheel_errors,
)
from diffbot_core.geometry import Pose, wrap_angle
from diffbot_core.kinematics import Twist, TwistCovariance


class Robust(NamedTuple):
    """How a correction is made weaker than its covariance R says."""

    inflation: float = 1.0
    """factor on R in the gain, for errors that are correlated with those of the measurement before"""
    gate: float = math.inf
    """NIS beyond which the gain falls in proportion to gate / NIS"""


PLAIN = Robust()
"""The textbook's correction."""


def _weakened(R: Array, S: Array, nis: float, robust: Robust) -> Array:
    """Return the R to correct with.

    The gain K and the reduction K S K' of P are multiplied by w = gate / NIS beyond the gate, which is the correction
    with S / w. The shift of the state then falls with 1 / |y|: a misread number is harmless, and a filter that is lost
    is never locked out.
    """
    used = S + (robust.inflation - 1.0) * R
    if nis > robust.gate:
        used = used * (nis / robust.gate)
    return R + (used - S)


def normalised_square(y: Array, S: Array) -> float:
    """Return y' S^-1 y.

    Raises:
        LinAlgError: if S is not positive definite to working precision.
    """
    u = np.linalg.solve(np.linalg.cholesky(S), y)
    return float(u.dot(u))


class PoseEkf(ExtendedKalmanFilter):  # type: ignore[misc]
    """EKF with midpoint motion model, driven by a measured twist.

    Its states are the pose; then, by choice, the errors of the wheels: of the radii left and right, and of the wheel
    separation; then, by choice, the three of :class:`LandmarkErrors`; then, by choice, the bias of a gyro. The measured
    twist is that of wheels of the configured size, see :func:`models.with_wheel_errors`.

    Always correct by :meth:`correct`: filterpy's ``update``, which it calls, does not wrap the heading.
    """

    def __init__(self, wheels: int = 0, *, landmark_states: bool = False, gyro: bool = False) -> None:
        """Start at the origin with a covariance that stands for an unknown pose; see :meth:`set_state`.

        Args:
            wheels: number of errors of the wheels that are states: 0, 2 or 3.
            landmark_states: the errors of landmarks are states.
            gyro: the bias of a gyro is a state.
        """
        landmarks = 3 + wheels + (3 if landmark_states else 0)
        size = landmarks + (1 if gyro else 0)
        super().__init__(dim_x=size, dim_z=3, dim_u=2)
        self.Q = np.zeros((size, size))
        self._wheels = wheels
        self.states = States(size, slice(3, 3 + wheels), slice(3 + wheels, landmarks), slice(landmarks, size))
        """where they stand"""
        self.newest: Innovation | None = None
        """of the newest measurement"""
        self.wheel_separation = 1.0
        """L [m]"""
        self.random_walk = 0.0
        """[1/s] random-walk variance per second of each error of the wheels"""
        self.bias_random_walk = 0.0
        """[rad^2/s^3] random-walk variance per second of the gyro's bias"""
        self.var_lateral = 0.0
        """[m^2] variance of the next motion across the robot, independent of its twist's"""
        self.set_state(np.zeros(size), np.diag([1e6, 1e6, math.pi**2, *[0.0] * (size - 3)]))

    def set_state(self, x: Array, P: Array) -> None:
        """Put the filter at mean ``x`` (n,) with covariance ``P`` (n, n); both are copied."""
        self.x = np.array(x, dtype=float)
        self.P = np.array(P, dtype=float)

    def corrected_twist(self, measured: Twist, x: Array) -> Twist:
        """Return a twist corrected by the errors of the wheels in the state ``x`` (n,), if there are any."""
        if not self._wheels:
            return measured
        errors: list[float] = x.tolist()[self.states.wheels]
        return with_wheel_errors(measured, WheelErrors(*errors, *[0.0] * (3 - len(errors))), self.wheel_separation)

    def predict_x(self, u: Any = 0) -> None:
        """Move the mean by the :class:`Motion` ``u`` and set F and Q."""
        measured, dt, covariance, rate = u
        x, y, theta, *errors = self.x.tolist()
        bias = self.states.gyro
        wheels = self.corrected_twist(measured, self.x)
        share = gyro_share(covariance, rate)
        twist = with_rate(wheels, rate.value - sum(self.x[bias]) - wheels.omega, share)
        arc = move(Pose(x, y, theta), twist, dt)
        self._set_pose_part(arc, twist.v, dt, covariance_with_rate(covariance, share))
        if self._wheels:
            separation_error = errors[2] if self._wheels == 3 else 0.0
            by = twist_derivatives(measured, wheels.omega, self.wheel_separation, separation_error)
            pairs = (by.v_left, by.omega_left), (by.v_right, by.omega_right), (0.0, by.omega_separation)
            for column, (v, omega) in enumerate(pairs[: self._wheels], 3):
                self.F[:3, column] = pose_derivatives(arc, dt, *derivatives_with_rate(v, omega, share))
                self.Q[column, column] = self.random_walk * dt
        if bias.start < bias.stop:
            self.F[:3, bias.start] = pose_derivatives(arc, dt, -share.v, -share.omega)
            self.Q[bias, bias] = self.bias_random_walk * dt
        x, y, theta = arc.end
        self.x = np.array((x, y, theta, *errors))

    def _set_pose_part(self, arc: Arc, v: float, dt: float, covariance: TwistCovariance) -> None:
        """Set the pose's part of F and Q; ``v`` is the velocity along the arc [m/s]."""
        F, Q = self.F, self.Q
        F[0, 2], F[1, 2] = arc.x_theta, arc.y_theta
        xx, xy, xt, yy, yt, tt = motion_noise(arc, v, dt, covariance)
        if self.var_lateral > 0.0:
            add_xx, add_xy, add_yy = lateral_noise(arc, dt, self.var_lateral)
            xx, xy, yy = xx + add_xx, xy + add_xy, yy + add_yy
        Q[0, 0], Q[1, 1], Q[2, 2] = xx, yy, tt
        Q[0, 1] = Q[1, 0] = xy
        Q[0, 2] = Q[2, 0] = xt
        Q[1, 2] = Q[2, 1] = yt

    def innovation(self, measurement: Measurement) -> Innovation:
        """Return what a measurement says that was not expected; it must be defined at this state."""
        x, P, states = self.x, self.P, self.states
        y = measurement.residual(measurement.z, measurement.expected(x, states))
        H = measurement.jacobian(x, states)
        return Innovation(y, H.dot(P).dot(H.T) + measurement.noise(x, P, states))

    def correct(self, measurement: Measurement, robust: Robust = PLAIN) -> float:
        """Correct with a measurement, which must be defined at this state; return the NIS.

        The gain K and the reduction of P are those of filterpy's ``update`` for the R that ``robust`` asks for; the NIS
        and :attr:`newest` are of the measurement's own.

        Raises:
            LinAlgError: if S is not positive definite to working precision.
        """
        self.newest = y, S = self.innovation(measurement)
        nis = normalised_square(y, S)
        before, uncertain = self.x, self.P.item(2, 2) > TURNED_VARIANCE
        R = measurement.noise(before, self.P, self.states)
        states = (self.states,)
        self.update(
            measurement.z,
            measurement.jacobian,
            measurement.expected,
            R if robust is PLAIN else _weakened(R, S, nis, robust),
            args=states,
            hx_args=states,
            residual=measurement.residual,
        )
        self.x[2] = wrap_angle(self.x.item(2))
        if uncertain:
            self._turn(self.K.dot(self.y))
        return nis

    def _turn(self, shift: Array) -> None:
        """Apply a correction ``shift`` (n,) of the mean along an arc, see :func:`models.arc_correction`."""
        dx, dy, turn = shift.tolist()[:3]
        along_x, along_y = arc_correction(dx, dy, turn)
        self.x[0] += along_x - dx
        self.x[1] += along_y - dy
        T = np.eye(self.x.size)
        T[0, 0] = T[1, 1] = math.cos(turn)
        T[1, 0] = math.sin(turn)
        T[0, 1] = -T[1, 0]
        self.P = T.dot(self.P).dot(T.T)
