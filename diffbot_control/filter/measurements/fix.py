"""Absolute measurements of the pose, and of the position without a heading, as a GNSS receiver gives it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from diffbot_control.filter.measurements.measurement import Array, DirectMeasurement, Source, States
from diffbot_core.geometry import Pose

FIXES = "fixes"
"""Name of the first source of fixes, ``global_pose``."""
_GLOBAL_POSE = Source(FIXES)
_UNKNOWN_HEADING = math.pi**2
"""[rad^2] variance of a heading of which nothing is known"""


def further_source(topic: str) -> Source:
    """Return the source of the fixes on another topic."""
    return Source(f"{FIXES} of {topic}")


@dataclass(frozen=True, eq=False)
class PoseFix(DirectMeasurement):
    """An absolute measurement of the pose."""

    part: ClassVar[slice] = slice(0, 3)

    pose: Pose
    R: Array
    """(3, 3) covariance [m, m, rad]"""
    source: Source = _GLOBAL_POSE

    @property
    def z(self) -> Array:
        """x, y [m], theta [rad]."""
        return np.array(self.pose)

    def noise(self, x: Array, P: Array, states: States) -> Array:
        """Return R: a fix is linear in the states."""
        return self.R

    def restart(self, pose: Pose) -> tuple[Pose, Array]:
        """Return the measured pose and R."""
        return self.pose, self.R


@dataclass(frozen=True, eq=False)
class PositionFix(DirectMeasurement):
    """An absolute measurement of the position alone."""

    part: ClassVar[slice] = slice(0, 2)

    x: float
    """[m]"""
    y: float
    """[m]"""
    R: Array
    """(2, 2) covariance [m, m]"""
    source: Source = _GLOBAL_POSE

    @property
    def z(self) -> Array:
        """x, y [m]."""
        return np.array((self.x, self.y))

    def noise(self, x: Array, P: Array, states: States) -> Array:
        """Return R: a fix is linear in the states."""
        return self.R

    def restart(self, pose: Pose) -> tuple[Pose, Array]:
        """Return the measured position with an unknown heading."""
        P = np.diag((0.0, 0.0, _UNKNOWN_HEADING))
        P[:2, :2] = self.R
        return Pose(self.x, self.y, pose.theta), P


def fix_of(stamp: int, pose: Pose, R: Array, source: Source = _GLOBAL_POSE) -> PoseFix | PositionFix:
    """Return a fix of covariance ``R`` (3, 3); without a heading, if that has a deviation of pi or more."""
    if R.item(8) >= _UNKNOWN_HEADING:
        return PositionFix(stamp, pose.x, pose.y, R[:2, :2], source)
    return PoseFix(stamp, pose, R, source)
