"""Settings of the compiled filter, and the columns of its result."""

from __future__ import annotations

import math
from typing import NamedTuple

NIS, NUMBERS, TERM, WHITE, INNOVATION, WEIGHT, COLUMNS = 0, 1, 2, 3, 6, 9, 10
"""Columns of the result: NIS, count of numbers, log likelihood, whitened innovation (3), innovation (3), weight."""
MESSAGE, DENSITY, MOTION = 0, 1, 2
LOG_2PI = math.log(2.0 * math.pi)
NEVER = -1.0
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
    times: tuple[float, float, float]
    """[s] correlation times of headings, of each landmark, of fixes; 0: independent"""
    fix_bias: bool
    """correlated errors of fixes are states; otherwise their R is inflated"""
    range_factor: float
    """on the standard deviation of ranges; likewise the next ones"""
    bearing_factor: float
    heading_factor: float
    xy_factor: float
    yaw_factor: float
    split: bool
    """move to each odometry stamp, as the filter does, although the twist does not change there with a delay"""
