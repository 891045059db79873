"""Headings for paths without headings."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from diffbot_core.geometry import Pose, wrap_angle

Array = NDArray[np.float64]

_CHORD = 0.2
"""[m] length of the path before and after a pose from which the direction at the pose is computed"""
_SAME, _CONTRADICTION = 1e-3, 0.3
"""[rad] headings that differ by less are equal; a heading that differs by more contradicts the direction of the path"""


def directions(poses: Sequence[Pose]) -> Array:
    """Return the direction [rad] of a path at each of its n poses, shape (n,); nan where the poses coincide.

    At a corner the direction bisects the angle. Where the path turns back, the direction is that of the next part.
    """
    points = np.array([(one.x, one.y) for one in poses])
    lengths = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    before = np.maximum(np.searchsorted(lengths, lengths - _CHORD, side="right") - 1, 0)
    after = np.minimum(np.searchsorted(lengths, lengths + _CHORD), len(poses) - 1)
    ahead = _units(points[after] - points)
    sums = _units(points - points[before]) + ahead
    chosen = np.where(np.hypot(*sums.T)[:, None] > _SAME, sums, ahead)
    return np.where(chosen.any(axis=1), np.arctan2(chosen[:, 1], chosen[:, 0]), np.nan)


def _units(vectors: Array) -> Array:
    lengths = np.hypot(*vectors.T)[:, None]
    units: Array = np.divide(vectors, lengths, out=np.zeros_like(vectors), where=lengths > 0.0)
    return units


def with_headings(poses: list[Pose], are_default: bool) -> list[Pose]:
    """Set the headings of a path without headings to the direction of the path; return any other path unchanged.

    Planners in two dimensions publish paths without headings: all headings between the first and the last pose are
    equal and contradict the direction of the path. The heading of the last pose belongs to the goal and does not
    change. If all headings are opposite to the direction, the robot is to drive the path backwards, so the path has
    headings, unless its orientations are the default of the message.

    Args:
        poses: poses of the path.
        are_default: True if the orientations between the first and the last pose are the default of the message.
    """
    if len(poses) < 3:
        return poses
    inner = poses[1:-1] if len(poses) > 3 else poses[:-1]
    common = inner[0].theta
    if any(abs(wrap_angle(one.theta - common)) > _SAME for one in inner):
        return poses
    found = directions(poses)[:-1]
    differences = [abs(wrap_angle(angle - common)) for angle in found if math.isfinite(angle)]
    turns_back = abs(wrap_angle(poses[-1].theta - common)) > _CONTRADICTION
    is_backwards = not turns_back and all(one >= math.pi - _CONTRADICTION for one in differences)
    if all(one <= _CONTRADICTION for one in differences) or (is_backwards and not are_default):
        return poses
    with_directions = [
        one._replace(theta=float(angle))
        if math.isfinite(angle) and abs(wrap_angle(one.theta - common)) <= _SAME
        else one
        for one, angle in zip(poses, found, strict=False)
    ]
    return [*with_directions, poses[-1]]
