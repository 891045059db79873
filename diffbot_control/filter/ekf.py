"""The filter: filterpy's extended Kalman filter for a planar pose, with the models of :mod:`models`.

State ``x = (x, y, theta)`` in the frame of the absolute fixes [m, m, rad], and behind it the constant errors that are
estimated, see :class:`PoseEkf`; letters as in the field: covariance ``P``, transition Jacobian ``F``, process noise
``Q``, measurement Jacobian ``H``, measurement noise ``R``.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from diffbot_control.filter.covariance import inverse
from diffbot_control.filter.filterpy_ekf import ExtendedKalmanFilter
from diffbot_control.filter.landmark_calibration import NO_ERRORS, LandmarkErrors, with_landmark_errors
from diffbot_control.filter.measurements import Array
from diffbot_control.filter.models import (
    TURNED_VARIANCE,
    Arc,
    LandmarkExpectation,
    Motion,
    RadiusErrors,
    arc_correction,
    expect_landmark,
    heading_innovation,
    is_at_landmark,
    lateral_noise,
    motion_noise,
    move,
    pose_innovation,
    radius_derivatives,
    separation_derivatives,
    with_radius_errors,
    with_separation_error,
)
from diffbot_core.geometry import Point, Pose, wrap_angle
from diffbot_core.kinematics import Twist


class Robust(NamedTuple):
    """How a correction is made weaker than its covariance R says."""

    inflation: float = 1.0
    """factor on R in the gain, for errors that are correlated with those of the measurement before"""
    gate: float = math.inf
    """NIS beyond which the gain falls in proportion to gate / NIS"""


PLAIN = Robust()
"""The textbook's correction."""


def _weakened(R: Array, S: Array, nis: float, robust: Robust) -> tuple[Array, Array]:
    """Return the R and the inverse of the S to correct with.

    The gain K and the reduction K S K' of P are multiplied by w = gate / NIS beyond the gate, which is the correction
    with S / w. The shift of the state then falls with 1 / |y|: a misread number is harmless, and a filter that is lost
    is never locked out. The NIS stays that of the plain S.
    """
    used = S + (robust.inflation - 1.0) * R
    if nis > robust.gate:
        used = used * (nis / robust.gate)
    return R + (used - S), inverse(used)


class PoseEkf(ExtendedKalmanFilter):  # type: ignore[misc]
    """EKF with midpoint motion model, driven by a measured twist.

    Its states are the pose; then, by choice, the errors of the wheels: of the radii left and right, and of the wheel
    separation; then, by choice, the three of :class:`LandmarkErrors`. The measured twist is that of wheels of the
    configured size, see :func:`models.with_radius_errors`.

    Always use :meth:`predict` with a :class:`Motion` and the ``update_`` methods: filterpy's own ``update`` and
    ``predict_update`` know neither these models nor the wrapping of angles.
    """

    def __init__(self, wheels: int = 0, *, landmark_states: bool = False) -> None:
        """Start at the origin with a covariance that stands for an unknown pose; see :meth:`set_state`.

        Args:
            wheels: number of errors of the wheels that are states: 0, 2 or 3.
            landmark_states: the errors of landmarks are states.
        """
        states = 3 + wheels + (3 if landmark_states else 0)
        super().__init__(dim_x=states, dim_z=3, dim_u=2)
        self.Q = np.zeros((states, states))
        self._wheels = wheels
        self.wheel_part = slice(3, 3 + wheels)
        """of the states: the errors of the wheels"""
        self.landmark_part = slice(3 + wheels, states)
        """of the states: the errors of landmarks"""
        self._H_pose: Array = np.eye(3, states)
        self._H_heading = self._H_pose[2:]
        self.wheel_separation = 1.0
        """L [m]"""
        self.random_walk = 0.0
        """[1/s] random-walk variance per second of each error of the wheels"""
        self.landmark_errors = NO_ERRORS
        """the errors of landmarks, if they are not states"""
        self.var_lateral = 0.0
        """[m^2] variance of the next motion across the robot, independent of its twist's"""
        self.set_state(np.zeros(states), np.diag([1e6, 1e6, math.pi**2, *[0.0] * (states - 3)]))

    def set_state(self, x: Array, P: Array) -> None:
        """Put the filter at mean ``x`` (n,) with covariance ``P`` (n, n); both are copied."""
        self.x = np.array(x, dtype=float)
        self.P = np.array(P, dtype=float)

    def predict(self, u: Any = 0) -> None:
        """Move mean and covariance by the :class:`Motion` ``u``, as filterpy's ``predict`` without copies of both."""
        self.predict_x(u)
        F = self.F
        self.P = F.dot(self.P).dot(F.T) + self.Q

    def predict_x(self, u: Any = 0) -> None:
        """Move the mean by the :class:`Motion` ``u`` and set F and Q."""
        twist, dt, _ = u
        x, y, theta, *errors = self.x.tolist()
        if self._wheels:
            twist = self._corrected(twist, errors)
        arc = move(Pose(x, y, theta), twist, dt)
        self._set_pose_part(arc, twist.v, u)
        if self._wheels:
            self._set_wheel_part(arc, twist, errors, u)
        x, y, theta = arc.end
        self.x = np.array((x, y, theta, *errors))

    def _corrected(self, measured: Twist, errors: list[float]) -> Twist:
        """Return the twist of wheels with the first of these ``errors``."""
        twist = with_radius_errors(measured, RadiusErrors(errors[0], errors[1]), self.wheel_separation)
        return with_separation_error(twist, errors[2]) if self._wheels == 3 else twist

    def _set_wheel_part(self, arc: Arc, twist: Twist, errors: list[float], u: Motion) -> None:
        """Set the part of F and Q that belongs to the errors of the wheels; ``twist`` is the corrected one."""
        F, Q, dt = self.F, self.Q, u.dt
        separation = errors[2] if self._wheels == 3 else 0.0
        F[0, 3], F[0, 4], F[1, 3], F[1, 4], F[2, 3], F[2, 4] = radius_derivatives(
            arc, u.twist, dt, self.wheel_separation, 1.0 + separation
        )
        Q[3, 3] = Q[4, 4] = self.random_walk * dt
        if self._wheels == 3:
            F[0, 5], F[1, 5], F[2, 5] = separation_derivatives(arc, twist, dt, separation)
            Q[5, 5] = self.random_walk * dt

    def _set_pose_part(self, arc: Arc, v: float, u: Motion) -> None:
        """Set the pose's part of F and Q; ``v`` is the velocity along the arc [m/s]."""
        F, Q = self.F, self.Q
        F[0, 2], F[1, 2] = arc.x_theta, arc.y_theta
        xx, xy, xt, yy, yt, tt = motion_noise(arc, v, u.dt, u.covariance)
        if self.var_lateral > 0.0:
            add_xx, add_xy, add_yy = lateral_noise(arc, u.dt, self.var_lateral)
            xx, xy, yy = xx + add_xx, xy + add_xy, yy + add_yy
        Q[0, 0], Q[1, 1], Q[2, 2] = xx, yy, tt
        Q[0, 1] = Q[1, 0] = xy
        Q[0, 2] = Q[2, 0] = xt
        Q[1, 2] = Q[2, 1] = yt

    def update_pose(self, measured: Pose, R: Array, robust: Robust = PLAIN) -> float:
        """Correct with a pose fix of covariance ``R`` (3, 3); return the NIS."""
        x = self.x
        dx, dy, turn = pose_innovation(measured, Pose(x.item(0), x.item(1), x.item(2)))
        return self._update((dx, dy, turn), R, self._H_pose, robust)

    def update_heading(self, measured: float, R: Array, robust: Robust = PLAIN) -> float:
        """Correct with a heading [rad] of variance ``R`` (1, 1) [rad^2]; return the NIS."""
        return self._update((heading_innovation(measured, self.x.item(2)),), R, self._H_heading, robust)

    def update_landmark(
        self, distance: float, bearing: float, R: Array, landmark: Point, robust: Robust = PLAIN
    ) -> float:
        """Correct with range and bearing of a known point, or with one of them.

        Args:
            distance: range [m].
            bearing: [rad] in the robot's frame.
            R: (2, 2) their covariance; the variance of the linearisation error is added. A number whose variance is not
                finite is missing; the other is used alone.
            landmark: position of the point in the frame of the state [m].
            robust: see :class:`Robust`.

        Returns:
            The NIS; inf, and nothing is corrected, if the estimated position is at the landmark, where no bearing is
            defined.
        """
        x, y, theta = self.x.tolist()[:3]
        pose = Pose(x, y, theta)
        if is_at_landmark(pose, landmark):
            return math.inf
        expected, H = self._expected(pose, landmark)
        innovation = distance - expected.range, heading_innovation(bearing, expected.bearing)
        var_range, var_bearing = R.item(0), R.item(3)
        if not math.isfinite(var_bearing):
            return self._update(innovation[:1], np.array([[var_range + expected.added_var_range]]), H[:1], robust)
        if not math.isfinite(var_range):
            return self._update(innovation[1:], np.array([[var_bearing + expected.added_var_bearing]]), H[1:], robust)
        R = R + np.diag((expected.added_var_range, expected.added_var_bearing))
        return self._update(innovation, R, H, robust)

    def _expected(self, pose: Pose, landmark: Point) -> tuple[LandmarkExpectation, Array]:
        """Return the expected measurement of a landmark and its Jacobian (2, n)."""
        expected = expect_landmark(pose, landmark, self.P.item(0, 0) + self.P.item(1, 1))
        H = np.zeros((2, self.x.size))
        H[1, 2] = -1.0
        part = self.landmark_part
        if part.start < part.stop:
            H[0, part] = 1.0, expected.range, 0.0
            H[1, part.stop - 1] = 1.0
            expected = with_landmark_errors(expected, LandmarkErrors(*self.x[part].tolist()))
        elif self.landmark_errors is not NO_ERRORS:
            expected = with_landmark_errors(expected, self.landmark_errors)
        H[0, 0], H[0, 1] = expected.range_x, expected.range_y
        H[1, 0], H[1, 1] = expected.bearing_x, expected.bearing_y
        return expected, H

    def _update(self, innovation: tuple[float, ...], R: Array, H: Array, robust: Robust) -> float:
        """Correct with an innovation and a Jacobian that are known already; return the NIS.

        The equations of filterpy's ``update``, to which a test holds it, without the copies of measurement, prior and
        posterior that nothing here reads.
        """
        P = self.P
        y = np.array(innovation)
        PHT = P.dot(H.T)
        S = H.dot(PHT) + R
        SI = inverse(S)
        nis = float(y.dot(SI).dot(y))
        if robust is not PLAIN:
            R, SI = _weakened(R, S, nis, robust)
        K = PHT.dot(SI)
        shift = K.dot(y)
        x = self.x + shift
        x[2] = wrap_angle(x.item(2))
        I_KH = self._I - K.dot(H)
        self.x = x
        # Joseph form: stays symmetric and positive definite under rounding.
        self.P = I_KH.dot(P).dot(I_KH.T) + K.dot(R).dot(K.T)
        if P.item(2, 2) > TURNED_VARIANCE:
            self._turn(shift)
        self.y, self.S = y, S
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
