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


class FixNoise(NamedTuple):
    """Covariance of a pose: upper triangle of the (3, 3) matrix of x, y [m], theta [rad]."""

    xx: float
    xy: float
    yy: float
    xt: float
    yt: float
    tt: float


def robot_at_dock(detected: Pose) -> Pose:
    """Return the pose of the robot in the frame of the dock, given the pose of the dock in the frame of the robot."""
    return into_frame(Pose(0.0, 0.0, 0.0), detected)


def noise_at_dock(robot: Pose, var_position: float, var_heading: float) -> FixNoise:
    """Return the covariance of :func:`robot_at_dock` to first order.

    An error of the measured heading rotates the robot about the dock, so the position error grows with the distance.

    Args:
        robot: pose of the robot in the frame of the dock.
        var_position: variance of the measured x and of the measured y, which are independent [m^2].
        var_heading: variance of the measured heading [rad^2].
    """
    x, y = robot.x, robot.y
    return FixNoise(
        var_position + var_heading * y * y,
        -var_heading * x * y,
        var_position + var_heading * x * x,
        -var_heading * y,
        var_heading * x,
        var_heading,
    )


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
