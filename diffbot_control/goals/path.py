"""The way along a path: its length, the goals that were passed, and the time that remains."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from itertools import takewhile

from diffbot_core.geometry import Pose

_MIN_SHARE = 0.05
"""share of the distance to cover before the mean speed so far is meaningful"""


def distance_along(pose: Pose, goals: Iterable[Pose]) -> float:
    """Return the length [m] of the straight lines from ``pose`` through all ``goals``."""
    length, last = 0.0, pose
    for goal in goals:
        length += math.hypot(goal.x - last.x, goal.y - last.y)
        last = goal
    return length


def goals_passed(pose: Pose, goals: Sequence[Pose], radius: float) -> int:
    """Return how many of the next goals in a row are within ``radius`` [m] of a pose; the last goal never counts."""
    near = takewhile(lambda one: math.hypot(one.x - pose.x, one.y - pose.y) < radius, goals[:-1])
    return sum(1 for _ in near)


def time_remaining(distance: float, first_distance: float, elapsed: float, max_speed: float) -> float:
    """Estimate the time [s] to the goal from the mean speed so far, at first from the speed limit.

    Args:
        distance: [m] that remains.
        first_distance: [m] that remained when the goal was accepted.
        elapsed: [s] since then.
        max_speed: [m/s] limit; may be infinite, or 0 for a robot that must not move.
    """
    covered = first_distance - distance
    if covered > _MIN_SHARE * first_distance and elapsed > 0.0:
        return distance * elapsed / covered
    return distance / max_speed if max_speed > 0.0 else math.inf
