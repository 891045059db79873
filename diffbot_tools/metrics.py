"""Figures of merit of a run from its true poses, and quantiles over many runs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from diffbot_core.errors import InvalidValueError
from diffbot_core.geometry import Pose, into_frame

Array = NDArray[np.float64]


class GoalMetrics(NamedTuple):
    """How one goal was reached."""

    final: Pose
    """last true pose [m, m, rad], in the goal's frame"""
    position_error: float
    """[m] distance of the last true pose from the goal"""
    heading_error: float
    """[rad] |heading error| of the last true pose"""
    settling_time: float
    """[s] from the first pose until the last entry into the tolerances; nan if the run does not end inside them"""
    path_length: float
    """[m] travelled, forwards and backwards"""
    direct_distance: float
    """[m] from the first pose to the goal"""


def goal_metrics(time: Array, poses: Array, goal: Pose, xy_tolerance: float, yaw_tolerance: float) -> GoalMetrics:
    """Evaluate the drive to one goal.

    Args:
        time: (n,) [s], increasing.
        poses: (n, 3) true poses [m, m, rad], in the frame of ``goal``.
        goal: the goal pose.
        xy_tolerance: [m] for the settling time.
        yaw_tolerance: [rad] for the settling time.

    Raises:
        InvalidValueError: if there are no poses or their number is not that of the times.
    """
    if len(time) == 0 or poses.shape != (len(time), 3):
        raise InvalidValueError("poses", poses.shape, f"({len(time)}, 3) with at least one row")
    local = np.array([into_frame(Pose(*row), goal) for row in poses.tolist()])
    distance = np.hypot(local[:, 0], local[:, 1])
    inside = (distance <= xy_tolerance) & (np.abs(local[:, 2]) <= yaw_tolerance)
    x, y, theta = local[-1].tolist()
    return GoalMetrics(
        Pose(x, y, theta),
        float(distance[-1]),
        abs(theta),
        settling_time(time, inside),
        path_length(poses),
        float(distance[0]),
    )


def settling_time(time: Array, inside: NDArray[np.bool_]) -> float:
    """Time [s] from the first sample until ``inside`` holds for good; nan if it does not hold at the end."""
    if not inside[-1]:
        return math.nan
    outside = np.flatnonzero(~inside)
    first = int(outside[-1]) + 1 if outside.size else 0
    return float(time[first] - time[0])


def path_length(poses: Array) -> float:
    """Length [m] of the polygon through ``poses`` (n, 2 or more columns)."""
    return float(np.hypot(*np.diff(poses[:, :2], axis=0).T).sum()) if len(poses) > 1 else 0.0


def quantiles(values: Array, levels: Mapping[str, float]) -> dict[str, float | None]:
    """Return the quantile of ``values`` (n,) at each of the named levels in [0, 1], interpolated linearly.

    Every quantile of no values is None.
    """
    if len(values) == 0:
        return dict.fromkeys(levels)
    return dict(zip(levels, np.quantile(values, tuple(levels.values())).tolist(), strict=True))
