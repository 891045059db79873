"""The algebra of the Kalman filter, computed by filterpy.

The simulation compiles the whole filter except these functions, which it replaces by loops; a test compares both.
Letters: covariance P, transition Jacobian F, process noise Q, measurement Jacobian H, measurement noise R, gain K.
"""

from __future__ import annotations

import threading
from typing import Any

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter

from diffbot_control.filter.models import Array


class _ErrorFilter(ExtendedKalmanFilter):  # type: ignore[misc]
    """filterpy's filter for the error of the mean, which is 0 before each step; :mod:`models` moves the mean."""

    def predict_x(self, u: Any = 0) -> None:
        """Do nothing, since the error stays 0."""


class _Filters(threading.local):
    """Filters of each thread by their number of states, since a filterpy filter keeps its arrays between calls."""

    def __init__(self) -> None:
        self._by_size: dict[int, _ErrorFilter] = {}

    def of_size(self, n: int) -> _ErrorFilter:
        if n not in self._by_size:
            self._by_size[n] = _ErrorFilter(dim_x=n, dim_z=1)
        return self._by_size[n]


_filters = _Filters()


def propagate(P: Array, F: Array, Q: Array) -> Array:
    """Return F P F' + Q; all matrices are (n, n)."""
    ekf = _filters.of_size(len(P))
    ekf.P, ekf.F, ekf.Q = P, F, Q
    ekf.predict()
    return np.asarray(ekf.P)


def innovation_covariance(P: Array, H: Array, R: Array) -> Array:
    """Return H P H' + R (m, m)."""
    S: Array = H.dot(P).dot(H.T) + R
    return S


def correct(P: Array, y: Array, H: Array, R: Array) -> tuple[Array, Array]:
    """Correct with an innovation.

    Args:
        P: covariance (n, n) before the correction.
        y: innovation (m,).
        H: derivative of the measurement with respect to the state (m, n).
        R: covariance of the measurement (m, m); H P H' + R must be regular.

    Returns:
        Shift K y (n,) of the mean, and corrected covariance (I - K H) P (I - K H)' + K R K' (n, n).
    """
    ekf = _filters.of_size(len(P))
    ekf.x, ekf.P = np.zeros(len(P)), P
    ekf.update(y, lambda _: H, lambda _: 0.0, R)
    return np.asarray(ekf.x), np.asarray(ekf.P)


def condition(x: Array, P: Array, at: int, value: float) -> tuple[Array, Array]:
    """Return mean (n,) and covariance (n, n) given the value of the state with index ``at``; P[at, at] > 0."""
    gain = P[at] / P[at, at]
    return x + (value - x[at]) * gain, P - P[at, at] * gain * gain.reshape(len(gain), 1)
