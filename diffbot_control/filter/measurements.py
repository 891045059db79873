"""Input of the filter: odometry steps, and measurements of the pose, the heading and landmarks."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from diffbot_core.geometry import Point, Pose
from diffbot_core.kinematics import Twist, TwistCovariance

Array = NDArray[np.float64]


class OdometryStep(NamedTuple):
    """Mean twist since the odometry before."""

    stamp: int
    """[ns] end of the interval"""
    twist: Twist
    covariance: TwistCovariance


class PoseFix(NamedTuple):
    """An absolute measurement of the pose."""

    stamp: int
    """[ns]"""
    pose: Pose
    R: Array
    """(3, 3) covariance [m, m, rad]"""
    source: int = 0
    """0: global_pose; 1, 2, ...: the further sources"""

    @property
    def values(self) -> tuple[float, ...]:
        """The measured numbers x, y, theta, and a further source: two sources may measure alike."""
        return (*self.pose, float(self.source)) if self.source else self.pose


class Heading(NamedTuple):
    """An absolute measurement of the heading."""

    stamp: int
    """[ns]"""
    theta: float
    """[rad]"""
    R: Array
    """(1, 1) variance [rad^2]"""

    @property
    def values(self) -> tuple[float, ...]:
        """The measured number, as a tuple."""
        return (self.theta,)


class LandmarkMeasurement(NamedTuple):
    """Range and bearing of a known landmark in the frame of the robot."""

    stamp: int
    """[ns]"""
    range: float
    """[m]"""
    bearing: float
    """[rad]"""
    R: Array
    """(2, 2) covariance [m, rad]; a variance that is not finite marks a missing number"""
    landmark: Point
    """position in the frame of the estimate [m]"""

    @property
    def numbers(self) -> int:
        """How many numbers were measured: 2, or 1 if the variance of range or bearing is not finite."""
        return 2 if math.isfinite(self.R.item(0) + self.R.item(3)) else 1

    @property
    def values(self) -> tuple[float, ...]:
        """Range and bearing, and the landmark's x and y: two landmarks may be measured alike."""
        return (self.range, self.bearing, *self.landmark)


Measurement = PoseFix | Heading | LandmarkMeasurement
