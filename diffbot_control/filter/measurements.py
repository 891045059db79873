"""What the filter takes in: odometry steps, and measurements of the pose, the heading and landmarks."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from diffbot_core.kinematics import Twist

Array = NDArray[np.float64]


class Measurement(NamedTuple):
    """A pose fix, z (3,), a heading, z (1,), or range and bearing of a landmark, z (2,); R is (n, n)."""

    stamp: int
    """[ns]"""
    z: Array
    R: Array
    landmark: tuple[float, float] | None = None
    """x, y of the landmark [m]"""


class OdometryStep(NamedTuple):
    """Mean twist since the last odometry, with covariance."""

    stamp: int
    """[ns] end of the interval"""
    twist: Twist
    var_v: float
    """[m^2/s^2]"""
    cov_v_omega: float
    """[m rad/s^2]"""
    var_omega: float
    """[rad^2/s^2]"""
