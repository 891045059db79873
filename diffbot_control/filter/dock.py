"""Pose of the robot in the frame of a detected dock, which is the inverse of the detection.

The docked robot stands at the origin of the frame of the dock and points along its x axis. A filter in this frame does
not need a pose in map, so a relocation in map does not move the dock. Between detections the filter uses odometry only,
and its covariance grows.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from diffbot_core.geometry import Pose, into_frame, out_of_frame


def robot_at_dock(detected: Pose) -> Pose:
    """Return the pose of the robot in the frame of the dock, given the pose of the dock in the frame of the robot."""
    return into_frame(Pose(0.0, 0.0, 0.0), detected)


class DockedPose(NamedTuple):
    """Pose of the docked robot in the frame of the marker that a detector measures."""

    x: float
    """[m]"""
    y: float
    """[m]"""
    theta: float
    """[rad]"""

    def robot(self, marker: Pose) -> Pose:
        """Return the pose of the robot in the frame of the dock; ``marker`` is in the frame of the robot."""
        return robot_at_dock(out_of_frame(Pose(*self), marker))

    def covariance(self, marker: Pose, R: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the covariance (3, 3) of :meth:`robot` to first order, given the covariance ``R`` of ``marker``."""
        x, y, theta = self.robot(marker)
        offset_x, offset_y, _ = out_of_frame(Pose(*self), Pose(0.0, 0.0, marker.theta))
        # Jacobian of the docked pose in the frame of the robot with respect to the marker.
        docked_by_marker = np.array(((1.0, 0.0, -offset_y), (0.0, 1.0, offset_x), (0.0, 0.0, 1.0)))
        # Jacobian of the pose of the robot in the frame of the dock with respect to the docked pose.
        c, s = math.cos(theta), math.sin(theta)
        robot_by_docked = np.array(((-c, s, y), (-s, -c, -x), (0.0, 0.0, -1.0)))
        J = robot_by_docked @ docked_by_marker
        covariance: NDArray[np.float64] = J @ R @ J.T
        return covariance
