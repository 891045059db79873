"""Settings of the compiled filter, and the columns of its result."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

NIS, NUMBERS, TERM, WHITE, INNOVATION, WEIGHT, RATES, COLUMNS = 0, 1, 2, 3, 6, 9, 10, 11
"""Columns of the result: NIS, count of numbers, log likelihood, whitened innovation (3), innovation (3), weight, log
likelihood of the turn rates since the measurement before."""
MESSAGE, DENSITY, MOTION = 0, 1, 2
LOG_2PI = math.log(2.0 * math.pi)
NANO = 1e-9


class Settings(NamedTuple):
    """Plain numbers of a filter; names as in its parameters, the deviations as factors on what the events have."""

    separation: float
    """L [m]"""
    walk: float
    """[1/s] random-walk variance per second of each wheel error"""
    delay: float
    """[s]"""
    noise: int
    """MESSAGE, DENSITY or MOTION"""
    odometry_covariance_scale: float
    alpha1: float
    alpha2: float
    alpha3: float
    alpha4: float
    density_xy: float
    density_theta: float
    gates: tuple[float, float, float]
    """bounds of the NIS by number of values, beyond which a measurement is weighed by bound / NIS"""
    times: NDArray[np.float64]
    """(s,) [s] correlation times of the sensors, see :class:`events.Measurements`; 0: independent"""
    factors: NDArray[np.float64]
    """(s, 2) on the standard deviations: heading, none; range, bearing; of each source of fixes x
    and y, heading; the last row, of poses put in by hand, is 1"""
    gyro_factor: float
    """on the standard deviation of the turn rates"""
    gyro_bias_variance: float
    """[rad^2/s^2] at the start"""
    gyro_bias_walk: float
    """[rad^2/s^3]"""
    split: bool
    """move to each odometry stamp, as the filter does, although the twist does not change there with a delay"""
