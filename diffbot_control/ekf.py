"""The filter: filterpy's extended Kalman filter for a planar pose.

State ``x = (x, y, theta)`` in the frame of the absolute fixes [m, m, rad]; letters as in the field: covariance ``P``,
transition Jacobian ``F``, process noise ``Q``, measurement Jacobian ``H``, measurement noise ``R``.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter
from numpy.typing import NDArray

from diffbot_control.geometry import wrap_angle

Array = NDArray[np.float64]

_H_POSE = np.eye(3)
_H_HEADING = np.array([[0.0, 0.0, 1.0]])


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
    order in dt. Always use :meth:`predict` with a :class:`Motion`, :meth:`update_pose` and :meth:`update_heading`:
    filterpy's own ``predict_update`` knows neither this model nor the wrapping of angles.
    """

    def __init__(self) -> None:
        """Start at the origin with a covariance that says nothing is known; see :meth:`set_state`."""
        super().__init__(dim_x=3, dim_z=3, dim_u=2)
        self.set_state(np.zeros(3), np.diag([1e6, 1e6, math.pi**2]))

    def set_state(self, x: Array, P: Array) -> None:
        """Put the filter at mean ``x`` (3,) with covariance ``P`` (3, 3); both are copied."""
        self.x = np.array(x, dtype=float)
        self.P = np.array(P, dtype=float)

    def predict_x(self, u: Any = 0) -> None:
        """Move the mean by the :class:`Motion` ``u`` and set F and Q for filterpy's ``predict``."""
        v, omega, dt, var_v, cov, var_omega = u
        x, y, theta = self.x.tolist()
        middle = theta + 0.5 * omega * dt
        ahead_x, ahead_y = dt * math.cos(middle), dt * math.sin(middle)
        self.x = np.array((x + v * ahead_x, y + v * ahead_y, wrap_angle(theta + omega * dt)))
        F, Q = self.F, self.Q
        F[0, 2], F[1, 2] = -v * ahead_y, v * ahead_x
        # Q = G M G' with G = d f / d (v, omega) = [[ahead_x, side_x], [ahead_y, side_y], [0, dt]] and M the
        # covariance of the twist, written out: numpy needs five times as long for matrices so small.
        side_x, side_y = -0.5 * dt * v * ahead_y, 0.5 * dt * v * ahead_x
        Q[0, 0] = ahead_x * ahead_x * var_v + 2.0 * ahead_x * side_x * cov + side_x * side_x * var_omega
        Q[1, 1] = ahead_y * ahead_y * var_v + 2.0 * ahead_y * side_y * cov + side_y * side_y * var_omega
        Q[2, 2] = dt * dt * var_omega
        Q[0, 1] = Q[1, 0] = (
            ahead_x * ahead_y * var_v + (ahead_x * side_y + ahead_y * side_x) * cov + side_x * side_y * var_omega
        )
        Q[0, 2] = Q[2, 0] = dt * (ahead_x * cov + side_x * var_omega)
        Q[1, 2] = Q[2, 1] = dt * (ahead_y * cov + side_y * var_omega)

    def update_pose(self, z: Array, R: Array) -> None:
        """Correct with a pose fix ``z`` (3,) of covariance ``R`` (3, 3)."""
        self.R = R  # as an argument it would pass through numpy's slow isscalar
        self.update(z, _pose_jacobian, _pose_of_state, residual=_pose_residual)
        self.x[2] = wrap_angle(float(self.x[2]))

    def update_heading(self, z: Array, R: Array) -> None:
        """Correct with a heading ``z`` (1,) [rad] of variance ``R`` (1, 1) [rad^2]."""
        self.R = R
        self.update(z, _heading_jacobian, _heading_of_state, residual=_heading_residual)
        self.x[2] = wrap_angle(float(self.x[2]))


def _pose_jacobian(_x: Array) -> Array:
    return _H_POSE


def _pose_of_state(x: Array) -> Array:
    return x


def _pose_residual(z: Array, predicted: Array) -> Array:
    y = z - predicted
    y[2] = wrap_angle(float(y[2]))
    return y


def _heading_jacobian(_x: Array) -> Array:
    return _H_HEADING


def _heading_of_state(x: Array) -> Array:
    return x[2:]


def _heading_residual(z: Array, predicted: Array) -> Array:
    return np.array((wrap_angle(float(z[0] - predicted[0])),))
