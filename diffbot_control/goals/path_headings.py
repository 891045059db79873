"""Headings for paths that came without them.

Planners in two dimensions publish paths without headings. Such poses get the direction of the path as their heading.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from diffbot_control.filter.models import Array
from diffbot_core.geometry import Pose, wrap_angle

_CHORD = 0.2
"""[m] along the path, backwards and forwards, over which its direction is measured"""
_SAME, _CONTRADICTION = 1e-3, 0.3
"""[rad] headings that differ by less are equal; a heading that differs by more contradicts the direction of the path"""


def directions(poses: Sequence[Pose]) -> Array:
    """Return the direction (n,) [rad] of a path of n poses at each pose; nan where the path has no length.

    At a corner the direction bisects the angle. Where the path turns back, it is the direction of the next part.
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
    """Return a path whose poses have the direction of the path as heading, if the path came without headings.

    A path has no headings if those between its first and its last pose are all equal and contradict its direction. The
    last heading belongs to the goal and does not change. A straight path that is driven backwards has headings, unless
    its orientations are those of empty messages.

    Args:
        poses: of the path; the result is the same list if the path has headings.
        are_default: the orientations between the first and the last pose are those of empty messages.
    """
    if len(poses) < 3:
        return poses
    inner = poses[1:-1] if len(poses) > 3 else poses[:-1]
    common = inner[0].theta
    if any(abs(wrap_angle(one.theta - common)) > _SAME for one in inner):
        return poses
    found = directions(poses)[:-1]
    differences = [abs(wrap_angle(angle - common)) for angle in found if np.isfinite(angle)]
    turns_back = abs(wrap_angle(poses[-1].theta - common)) > _CONTRADICTION
    is_backwards = not turns_back and all(one >= np.pi - _CONTRADICTION for one in differences)
    if all(one <= _CONTRADICTION for one in differences) or (is_backwards and not are_default):
        return poses
    followed = [
        one._replace(theta=float(angle)) if np.isfinite(angle) and abs(wrap_angle(one.theta - common)) <= _SAME else one
        for one, angle in zip(poses, found, strict=False)
    ]
    return [*followed, poses[-1]]
