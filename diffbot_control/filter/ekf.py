"""The filter: filterpy's extended Kalman filter for a planar pose.

State ``x = (x, y, theta)`` in the frame of the absolute fixes [m, m, rad], and in :class:`CalibratingEkf` the relative
radius errors of both wheels; letters as in the field: covariance ``P``, transition Jacobian ``F``, process noise ``Q``,
measurement Jacobian ``H``, measurement noise ``R``.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from diffbot_control.filter.filterpy_ekf import ExtendedKalmanFilter
from diffbot_control.filter.landmark_map import linearisation_variance
from diffbot_control.filter.options import MIN_LANDMARK_DISTANCE
from diffbot_core.geometry import wrap_angle
from diffbot_core.kinematics import Twist, motion_noise, with_radius_errors

Array = NDArray[np.float64]


class Motion(NamedTuple):
    """Mean twist over a time ``dt`` with its covariance: the filter's input u."""

    v: float
    """[m/s]"""
    omega: float
    """[rad/s]"""
    dt: float
    """[s]"""
    var_v: float
    """[m^2/s^2]"""
    cov_v_omega: float
    """[m rad/s^2]"""
    var_omega: float
    """[rad^2/s^2]"""


class PoseEkf(ExtendedKalmanFilter):  # type: ignore[misc]
    """EKF with midpoint motion model, driven by a measured twist.

    f(x, u): theta_m = theta + omega dt / 2; x += v dt cos(theta_m); y += v dt sin(theta_m); theta += omega dt. Second
    order in dt. Always use :meth:`predict` with a :class:`Motion` and the ``update_`` methods: filterpy's own
    ``predict_update`` knows neither this model nor the wrapping of angles.
    """

    def __init__(self, states: int = 3) -> None:
        """Start at the origin with a covariance that says nothing is known; see :meth:`set_state`."""
        super().__init__(dim_x=states, dim_z=3, dim_u=2)
        self._H_pose: Array = np.eye(3, states)
        self._H_heading = self._H_pose[2:]
        self.set_state(np.zeros(states), np.diag([1e6, 1e6, math.pi**2, *[0.0] * (states - 3)]))

    def set_state(self, x: Array, P: Array) -> None:
        """Put the filter at mean ``x`` (n,) with covariance ``P`` (n, n); both are copied."""
        self.x = np.array(x, dtype=float)
        self.P = np.array(P, dtype=float)

    def predict_x(self, u: Any = 0) -> None:
        """Move the mean by the :class:`Motion` ``u`` and set F and Q for filterpy's ``predict``."""
        v, omega, dt, var_v, cov, var_omega = u
        x, y, theta = self.x.tolist()
        ahead_x, ahead_y = self._move(v, omega, dt, var_v, cov, var_omega, theta)
        self.x = np.array((x + v * ahead_x, y + v * ahead_y, wrap_angle(theta + omega * dt)))

    def _move(
        self, v: float, omega: float, dt: float, var_v: float, cov: float, var_omega: float, theta: float
    ) -> tuple[float, float]:
        """Set the pose's part of F and Q; return the derivatives of x and y by v."""
        middle = theta + 0.5 * omega * dt
        ahead_x, ahead_y = dt * math.cos(middle), dt * math.sin(middle)
        F, Q = self.F, self.Q
        F[0, 2], F[1, 2] = -v * ahead_y, v * ahead_x
        xx, xy, xt, yy, yt, tt = motion_noise(ahead_x, ahead_y, v, dt, (var_v, cov, var_omega))
        Q[0, 0], Q[1, 1], Q[2, 2] = xx, yy, tt
        Q[0, 1] = Q[1, 0] = xy
        Q[0, 2] = Q[2, 0] = xt
        Q[1, 2] = Q[2, 1] = yt
        return ahead_x, ahead_y

    def update_pose(self, z: Array, R: Array) -> float:
        """Correct with a pose fix ``z`` (3,) of covariance ``R`` (3, 3); return the NIS."""
        return self._update(z, R, self._pose_jacobian, _pose_of_state, _pose_residual)

    def update_heading(self, z: Array, R: Array) -> float:
        """Correct with a heading ``z`` (1,) [rad] of variance ``R`` (1, 1) [rad^2]; return the NIS."""
        return self._update(z, R, self._heading_jacobian, _heading_of_state, _heading_residual)

    def update_landmark(self, z: Array, R: Array, landmark: tuple[float, float]) -> float:
        """Correct with range and bearing of a known point; see :mod:`landmark_map` for near ones.

        Args:
            z: (2,) range [m] and bearing [rad] in the robot's frame.
            R: (2, 2) their covariance.
            landmark: x, y of the point in the frame of the state [m].

        Returns:
            The NIS; inf, and nothing is corrected, if the robot is believed to be at the landmark: the bearing means
            nothing there.
        """
        dx, dy = landmark[0] - self.x[0], landmark[1] - self.x[1]
        squared = float(dx * dx + dy * dy)
        if squared < MIN_LANDMARK_DISTANCE**2:
            return math.inf
        distance = math.sqrt(squared)
        H = np.zeros((2, self.x.size))
        H[0, 0], H[0, 1] = -dx / distance, -dy / distance
        H[1, 0], H[1, 1], H[1, 2] = dy / squared, -dx / squared, -1.0
        expected = np.array((distance, wrap_angle(math.atan2(dy, dx) - float(self.x[2]))))
        by_range, by_bearing = linearisation_variance(squared, self.P.item(0, 0) + self.P.item(1, 1))
        R = R + np.diag((by_range, by_bearing))
        return self._update(z, R, lambda _x: H, lambda _x: expected, _landmark_residual)

    def _update(self, z: Array, R: Array, jacobian: Any, expected: Any, residual: Any) -> float:
        self.R = R  # as an argument it would pass through numpy's slow isscalar
        self.update(z, jacobian, expected, residual=residual)
        self.x[2] = wrap_angle(self.x.item(2))
        return float(self.y.dot(self.SI).dot(self.y))

    def _pose_jacobian(self, _x: Array) -> Array:
        return self._H_pose

    def _heading_jacobian(self, _x: Array) -> Array:
        return self._H_heading


class CalibratingEkf(PoseEkf):
    """The same with the relative errors of the radii of the left and right wheel as states 3 and 4.

    The measured twist is that of wheels of nominal radius: see :func:`diffbot_core.kinematics.with_radius_errors`.
    """

    def __init__(self) -> None:
        """Start as :class:`PoseEkf`, with wheels known to be perfect."""
        super().__init__(states=5)
        self.wheel_separation = 1.0
        """L [m]"""
        self.walk = 0.0
        """variance per second that each wheel's error gains"""

    def predict_x(self, u: Any = 0) -> None:
        """Move the mean by the :class:`Motion` ``u`` and set F and Q for filterpy's ``predict``."""
        v, omega, dt, var_v, cov, var_omega = u
        L = self.wheel_separation
        x, y, theta, left, right = self.x.tolist()
        rim_left, rim_right = v - 0.5 * L * omega, v + 0.5 * L * omega
        v, omega = with_radius_errors(Twist(v, omega), left, right, L)
        ahead_x, ahead_y = self._move(v, omega, dt, var_v, cov, var_omega, theta)
        F, Q = self.F, self.Q
        turn_left, turn_right = -dt * rim_left / L, dt * rim_right / L
        F[2, 3], F[2, 4] = turn_left, turn_right
        # Each error turns the mean heading of the step by half of what it turns the heading by.
        F[0, 3], F[0, 4] = (
            0.5 * (rim_left * ahead_x + F[0, 2] * turn_left),
            0.5 * (rim_right * ahead_x + F[0, 2] * turn_right),
        )
        F[1, 3], F[1, 4] = (
            0.5 * (rim_left * ahead_y + F[1, 2] * turn_left),
            0.5 * (rim_right * ahead_y + F[1, 2] * turn_right),
        )
        Q[3, 3] = Q[4, 4] = self.walk * dt
        self.x = np.array((x + v * ahead_x, y + v * ahead_y, wrap_angle(theta + omega * dt), left, right))


def _pose_of_state(x: Array) -> Array:
    return x[:3]


def _pose_residual(z: Array, predicted: Array) -> Array:
    y = z - predicted
    y[2] = wrap_angle(y.item(2))
    return y


def _heading_of_state(x: Array) -> Array:
    return x[2:3]


def _heading_residual(z: Array, predicted: Array) -> Array:
    return np.array((wrap_angle(float(z[0] - predicted[0])),))


def _landmark_residual(z: Array, predicted: Array) -> Array:
    return np.array((float(z[0] - predicted[0]), wrap_angle(float(z[1] - predicted[1]))))
