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
_NO_LANDMARK = Point(0.0, 0.0)
Key = tuple[int, str, tuple[float, ...], tuple[float, ...]]


@dataclass(frozen=True, eq=False)
class Measurement:
    """Measured numbers with their stamp and covariance."""

    stamp: int
    """[ns]"""
    source: str
    """name of the source; errors of one source may be correlated in time, errors of two sources are independent"""
    kind: int
    """kind of measurement, e.g. :data:`models.POSE_FIX`"""
    z: Array
    """(m,) measured numbers [m], [rad]"""
    R: Array
    """(m, m) covariance of ``z``"""
    at: Point = _NO_LANDMARK
    """position of the landmark [m]; used for measurements of landmarks only"""

    @cached_property
    def key(self) -> Key:
        """Sort key for the order of fusion; only duplicates have equal keys."""
        return self.stamp, self.source, tuple(self.at), tuple(self.z.tolist())


class GyroSample(NamedTuple):
    """Measured turn rate; the errors of two samples are independent."""

    stamp: int
    """[ns]"""
    rate: float
    """[rad/s]"""
    variance: float
    """[rad^2/s^2]"""


def pose_fix(stamp: int, pose: Pose, R: Array, source: str = FIXES) -> Measurement:
    """Return a fix: a measurement of the pose with covariance ``R`` (3, 3) [m, m, rad].

    If the deviation of the heading is pi or more, as from a GNSS receiver, the fix contains only the position.
    """
    if R.item(2, 2) >= UNKNOWN_HEADING:
        return Measurement(stamp, source, POSITION_FIX, np.array(pose[:2]), np.ascontiguousarray(R[:2, :2]))
    return Measurement(stamp, source, POSE_FIX, np.array(pose), R)


def heading(stamp: int, theta: float, R: Array) -> Measurement:
    """Return a measurement of the heading ``theta`` [rad] by a compass with variance ``R`` (1, 1) [rad^2]."""
    return Measurement(stamp, HEADINGS, HEADING, np.array((theta,)), R)


def landmark(stamp: int, distance: float, bearing: float, R: Array, at: Point) -> Measurement:
    """Return a measurement of range and bearing of a landmark, or of one of them.

    Args:
        stamp: time of the measurement [ns].
        distance: range [m].
        bearing: angle of the line of sight in the frame of the robot [rad].
        R: covariance (2, 2) [m, rad]; a variance that is not finite marks a number that was not measured.
        at: position of the landmark on the map [m].
    """
    if not math.isfinite(R.item(0, 0)):
        return Measurement(stamp, LANDMARKS, BEARING, np.array((bearing,)), np.ascontiguousarray(R[1:, 1:]), at)
    if not math.isfinite(R.item(1, 1)):
        return Measurement(stamp, LANDMARKS, RANGE, np.array((distance,)), np.ascontiguousarray(R[:1, :1]), at)
    return Measurement(stamp, LANDMARKS, LANDMARK, np.array((distance, bearing)), R, at)
