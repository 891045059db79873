"""Planned paths (nav_msgs/Path): the points that the page draws, and when the controller no longer follows them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from diffbot_core.cdr import CdrCursor, CdrError
from diffbot_core.geometry import MAX_COORDINATE
from diffbot_tools.view.clock import Clock, Columns
from diffbot_tools.view.transforms import is_local

MAX_POINTS = 500
"""of a path that are drawn"""
MAX_PLANS, MAX_POSES = 200, 500_000
"""paths and poses that are read of a topic of a bag; later ones are left out"""

Point = tuple[float, float]


class Plan(NamedTuple):
    """A path that was received, or that no path is followed from now on."""

    log_time: int
    """[ns]"""
    points: list[Point]
    """[m] in the map; empty where a path ends"""


class PlanRows:
    """Collects the paths of one topic."""

    def __init__(self) -> None:
        """Start empty."""
        self.found: list[Plan] = []
        self.malformed = 0
        """messages that were left out"""
        self._poses = 0

    def add(self, log_time: int, data: bytes) -> None:
        """Add a message with its log time [ns]."""
        if len(self.found) >= MAX_PLANS or self._poses >= MAX_POSES:
            return
        try:
            points = read_plan(data)
        except CdrError:
            self.malformed += 1
            return
        self._poses += len(points)
        self.found.append(Plan(log_time, thinned(points)))


def read_plan(data: bytes) -> list[Point]:
    """Read the points of a Path; poses without a usable position are left out.

    Raises:
        CdrError: if it is none, or is given in a frame of the robot or its odometry.
    """
    cursor = CdrCursor(data)
    cursor.stamp()
    frame = cursor.text()
    points = []
    for _ in range(cursor.length()):
        cursor.stamp()
        own_frame = cursor.text()
        if is_local(own_frame or frame):
            raise CdrError("path not in the map")
        x, y, *_ = cursor.doubles(7)
        if math.isfinite(x + y) and max(abs(x), abs(y)) <= MAX_COORDINATE:
            points.append((x, y))
    return points


def thinned(points: Sequence[Point]) -> list[Point]:
    """Return at most MAX_POINTS of the points, first and last among them."""
    if len(points) <= MAX_POINTS:
        return list(points)
    return [points[round(index)] for index in np.linspace(0, len(points) - 1, MAX_POINTS).tolist()]


class PlanEnd:
    """Tells from controller/status when a path is no longer followed: its value ``waypoint`` disappears."""

    def __init__(self) -> None:
        """Start without a path."""
        self._is_on_path = False

    def is_over(self, values: Mapping[str, str]) -> bool:
        """Take the values of the next status; return whether a path was followed before it and is no longer."""
        was, self._is_on_path = self._is_on_path, "waypoint" in values
        return was and not self._is_on_path


def plan_columns(plans: Sequence[Plan], clock: Clock) -> Columns:
    """Return t [s], x and y [m] of all points: those of one path have one time, NaN ends it."""
    rows = [
        (clock.of_log_time(plan.log_time), x, y)
        for plan in sorted(plans, key=lambda one: one.log_time)
        for x, y in plan.points or [(math.nan, math.nan)]
    ]
    return dict(zip(("t", "x", "y"), np.array(rows).reshape(-1, 3).T, strict=True))
