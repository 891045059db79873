"""Measurements with their stamps, sources and covariances, as :class:`Localization` fuses them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from diffbot_control.filter.models import (
    BEARING,
    HEADING,
    LANDMARK,
    POSE_FIX,
    POSITION_FIX,
    RANGE,
    UNKNOWN_HEADING,
    Array,
)
from diffbot_core.geometry import Point, Pose

FIXES, HEADINGS, LANDMARKS = "fixes", "headings", "landmarks"
"""Names of the sources that always exist: ``global_pose``, the compass, and all landmarks together."""
NOWHERE = Point(0.0, 0.0)
"""Position of the landmark of a measurement that has none."""
Key = tuple[int, str, tuple[float, ...], tuple[float, ...]]


@dataclass(frozen=True, eq=False)
class Measurement:
    """Numbers that were measured at a time."""

    stamp: int
    """[ns]"""
    source: str
    """name of the source; errors of one source may be correlated in time, errors of two sources are independent"""
    kind: int
    """kind in :mod:`models`, which determines the numbers"""
    z: Array
    """(m,) the numbers [m], [rad]"""
    R: Array
    """(m, m) their covariance"""
    at: Point = NOWHERE
    """position of the landmark [m]"""

    @cached_property
    def key(self) -> Key:
        """Sort key of the order of fusion; only duplicates have equal keys."""
        return self.stamp, self.source, tuple(self.at), tuple(self.z.tolist())


class GyroSample(NamedTuple):
    """Turn rate at a time; the errors of two samples are independent."""

    stamp: int
    """[ns]"""
    rate: float
    """[rad/s]"""
    variance: float
    """[rad^2/s^2]"""


def pose_fix(stamp: int, pose: Pose, R: Array, source: str = FIXES) -> Measurement:
    """Return an absolute measurement of the pose with covariance ``R`` (3, 3) [m, m, rad].

    If the heading has a deviation of pi or more, as from a GNSS receiver, only the position is measured.
    """
    if R.item(2, 2) >= UNKNOWN_HEADING:
        return Measurement(stamp, source, POSITION_FIX, np.array(pose[:2]), np.ascontiguousarray(R[:2, :2]))
    return Measurement(stamp, source, POSE_FIX, np.array(pose), R)


def heading(stamp: int, theta: float, R: Array) -> Measurement:
    """Return a measurement of the heading ``theta`` [rad] by a compass, of variance ``R`` (1, 1) [rad^2]."""
    return Measurement(stamp, HEADINGS, HEADING, np.array((theta,)), R)


def landmark(stamp: int, distance: float, bearing: float, R: Array, at: Point) -> Measurement:
    """Return a measurement of range and bearing of a landmark in the frame of the robot, or of one of them.

    Args:
        stamp: [ns].
        distance: the range [m].
        bearing: [rad].
        R: covariance (2, 2) [m, rad]; a variance that is not finite marks a number that was not measured.
        at: position of the landmark [m].
    """
    if not math.isfinite(R.item(0, 0)):
        return Measurement(stamp, LANDMARKS, BEARING, np.array((bearing,)), np.ascontiguousarray(R[1:, 1:]), at)
    if not math.isfinite(R.item(1, 1)):
        return Measurement(stamp, LANDMARKS, RANGE, np.array((distance,)), np.ascontiguousarray(R[:1, :1]), at)
    return Measurement(stamp, LANDMARKS, LANDMARK, np.array((distance, bearing)), R, at)
