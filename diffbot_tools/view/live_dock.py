"""The dock of a running robot in the map: where the estimates in both frames place it, and its newest detections."""

from __future__ import annotations

from collections import deque
from typing import Any

from diffbot_control.law.docking_axis import MAX_UNCERTAINTY, DockingConfig
from diffbot_core.geometry import Pose, origin_of_frame, out_of_frame
from diffbot_core.uncertainty import Uncertainty

_MAX_POSES, _MAX_DETECTIONS = 100, 20
"""that are kept: 2 s of estimates at 50 Hz"""

Stamped = tuple[int, Pose]
"""Stamp [ns] and pose."""


class DockPlacer:
    """Places the dock and its detections by the estimate in map at their own time."""

    def __init__(self) -> None:
        """Start without an estimate, and with the defaults of the law."""
        self.config = DockingConfig()
        self._poses: deque[Stamped] = deque(maxlen=_MAX_POSES)
        self._in_dock: Stamped | None = None
        """the newest pose in the dock's frame that is not placed yet"""
        self._detections: deque[Stamped] = deque(maxlen=_MAX_DETECTIONS)
        """likewise of detections"""
        self._dock: Pose | None = None
        self._crosses: deque[Pose] = deque(maxlen=_MAX_DETECTIONS)

    def add_pose(self, stamp: int, pose: Pose) -> None:
        """Add an estimate in map; a stamp [ns] before the last one begins a new run."""
        if self._poses and stamp < self._poses[-1][0]:
            self._poses.clear()
            self._detections.clear()
            self._crosses.clear()
            self._in_dock = self._dock = None
        self._poses.append((stamp, pose))

    def add_dock_pose(self, stamp: int, pose: Pose, uncertainty: Uncertainty) -> None:
        """Add an estimate in the dock's frame."""
        if uncertainty.xy > MAX_UNCERTAINTY:
            self._in_dock = self._dock = None
        else:
            self._in_dock = stamp, pose

    def add_detection(self, stamp: int, pose: Pose) -> None:
        """Add a detection: the pose of the docked robot in the frame of the robot."""
        self._detections.append((stamp, pose))

    def newest(self) -> dict[str, Any] | None:
        """Place what has an estimate of its time; return what the page draws (page/dock.js), None for nothing."""
        if not self._poses:
            return None
        if self._in_dock is not None and self._in_dock[0] <= self._poses[-1][0]:
            stamp, pose = self._in_dock
            self._dock, self._in_dock = origin_of_frame(pose, self._nearest(stamp)), None
        while self._detections and self._detections[0][0] <= self._poses[-1][0]:
            stamp, pose = self._detections.popleft()
            self._crosses.append(out_of_frame(pose, self._nearest(stamp)))
        if self._dock is None and not self._crosses:
            return None
        config = self.config
        return {
            "pose": self._dock and list(self._dock),
            "detections": [[one.x, one.y] for one in self._crosses],
            "staging": config.staging_distance,
            "halfWidth": config.corridor * config.approach_length,
            "isBackward": config.dock_backward,
        }

    def _nearest(self, stamp: int) -> Pose:
        """Return the estimate in map nearest to a stamp [ns]: both filters give theirs at those of the odometry."""
        return min(reversed(self._poses), key=lambda one: abs(one[0] - stamp))[1]
