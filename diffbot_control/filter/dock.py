"""The robot's pose in the frame of a detected dock: the inverse of the detection. Pure functions of floats.

The docked robot stands at the origin of the dock's frame and points along its x axis. A filter in this frame does not
need a pose in map, so a relocation in map does not move the dock. Between detections the filter continues by odometry,
and its covariance grows accordingly.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from diffbot_core.geometry import Pose, into_frame, out_of_frame


class FixNoise(NamedTuple):
    """Covariance of a pose: the upper triangle of its (3, 3) matrix in x, y [m], theta [rad]."""

    xx: float
    xy: float
    yy: float
    xt: float
    yt: float
    tt: float


def robot_at_dock(detected: Pose) -> Pose:
    """Return the robot's pose in the dock's frame, given the dock's pose in the robot's frame."""
    return into_frame(Pose(0.0, 0.0, 0.0), detected)


def noise_at_dock(robot: Pose, var_position: float, var_heading: float) -> FixNoise:
    """Return the covariance of :func:`robot_at_dock` to first order.

    An error of the dock's heading turns the robot about the dock, so the error of its position grows with the distance.

    Args:
        robot: pose of the robot in the dock's frame.
        var_position: variance of the dock's x and of its y in the robot's frame, which are independent [m^2].
        var_heading: variance of the dock's heading in the robot's frame [rad^2].
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
        """Return the robot's pose in the dock's frame, given the marker's pose in the robot's frame."""
        return robot_at_dock(out_of_frame(Pose(*self), marker))

    def covariance(self, marker: Pose, R: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the covariance (3, 3) of :meth:`robot` to first order, given ``R`` (3, 3) of the marker's pose."""
        x, y, theta = self.robot(marker)
        offset_x, offset_y, _ = out_of_frame(Pose(*self), Pose(0.0, 0.0, marker.theta))
        # Jacobian of the docked pose in the robot's frame with respect to the marker's pose.
        docked_by_marker = np.array(((1.0, 0.0, -offset_y), (0.0, 1.0, offset_x), (0.0, 0.0, 1.0)))
        # Jacobian of the robot's pose in the dock's frame with respect to the docked pose.
        c, s = math.cos(theta), math.sin(theta)
        robot_by_docked = np.array(((-c, s, y), (-s, -c, -x), (0.0, 0.0, -1.0)))
        J = robot_by_docked @ docked_by_marker
        covariance: NDArray[np.float64] = J @ R @ J.T
        return covariance
