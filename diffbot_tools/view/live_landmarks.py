"""Landmarks of a running robot: a cloud waits until the estimate of its time has come."""

from __future__ import annotations

import math
from collections import deque
from typing import Any

import numpy as np

from diffbot_core.geometry import Pose
from diffbot_tools.trajectory import Trajectory
from diffbot_tools.view.landmarks import Measured, local_points, placed

_MAX_POSES, _MAX_CLOUDS = 200, 20
"""that are kept: 4 s of estimates at 50 Hz"""


class LandmarkPlacer:
    """Places the points of clouds by estimated poses."""

    def __init__(self) -> None:
        """Start without an estimate."""
        self._poses: deque[tuple[int, Pose]] = deque(maxlen=_MAX_POSES)
        self._clouds: deque[tuple[int, list[tuple[int, float, float]]]] = deque(maxlen=_MAX_CLOUDS)

    def add_pose(self, stamp: int, pose: Pose) -> None:
        """Add an estimate; a stamp [ns] before the last one begins a new run."""
        last = self._poses[-1][0] if self._poses else stamp - 1
        if stamp < last:
            self._poses.clear()
            self._clouds.clear()
        if stamp != last:
            self._poses.append((stamp, pose))

    def add_cloud(self, message: Any) -> None:
        """Add a cloud, see :func:`diffbot_tools.view.landmarks.read_cloud`.

        Raises:
            BadMessageError: if it cannot be used.
        """
        self._clouds.append((message.header.stamp, local_points(message)))

    def newest(self) -> tuple[int, list[list[float]]] | None:
        """Return the newest cloud that can be placed, once: its stamp [ns]; x, y [m] and number of its landmarks."""
        if not self._clouds or not self._poses:
            return None
        ready = [cloud for cloud in self._clouds if cloud[0] <= self._poses[-1][0]]
        if not ready:
            return None
        waiting = [cloud for cloud in self._clouds if cloud[0] > self._poses[-1][0]]
        self._clouds = deque(waiting, maxlen=_MAX_CLOUDS)
        stamp, points = max(ready, key=lambda cloud: cloud[0])
        numbers = [number for number, _, _ in points]
        local = np.array([point for _, *point in points]).reshape(-1, 2)
        places = placed(Measured(np.full(len(points), stamp), np.array(numbers), local), self._path())
        found = zip(places.tolist(), numbers, strict=True)
        return stamp, [[*place, number] for place, number in found if all(map(math.isfinite, place))]

    def _path(self) -> Trajectory:
        poses = np.array([pose for _, pose in self._poses])
        poses[:, 2] = np.unwrap(poses[:, 2])
        return Trajectory(np.array([stamp for stamp, _ in self._poses], np.int64), poses)
