"""The robot's pose in the frame of a dock that it sees: a detection turned round. Pure functions of floats.

The dock's frame has its origin where the robot stands when it is docked, and the robot's heading then as x axis. A
filter in this frame needs no pose in map, so a relocation there does not move the dock; between detections, and when
there are none any more, it goes on by odometry, and its covariance says how far that can be trusted.
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
    """Return the robot's pose in the dock's frame, given the dock's in the robot's."""
    return into_frame(Pose(0.0, 0.0, 0.0), detected)


def noise_at_dock(robot: Pose, var_position: float, var_heading: float) -> FixNoise:
    """Return the covariance of :func:`robot_at_dock` to first order.

    An error of the dock's heading turns the robot about the dock, so it moves it the farther the farther it is away.

    Args:
        robot: pose in the dock's frame.
        var_position: variance of the dock's x and of its y in the robot's frame, independent [m^2].
        var_heading: of its heading there [rad^2].
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


def scaled_noise(noise: FixNoise, position: float, heading: float) -> FixNoise:
    """Return a covariance with the variances of position and heading scaled by these factors."""
    both = math.sqrt(position * heading)
    return FixNoise(
        position * noise.xx,
        position * noise.xy,
        position * noise.yy,
        both * noise.xt,
        both * noise.yt,
        heading * noise.tt,
    )


class Mounting(NamedTuple):
    """Where a detector is on the robot, and where the docked robot stands relative to what it detects."""

    detector: Pose
    """[m, m, rad] in the robot's frame"""
    docked: Pose
    """[m, m, rad] of the docked robot in the frame of what is detected"""

    def robot(self, detected: Pose) -> Pose:
        """Return the robot's pose in the dock's frame for a pose detected in the detector's."""
        return robot_at_dock(out_of_frame(self.docked, out_of_frame(detected, self.detector)))

    def covariance(self, detected: Pose, R: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the covariance (3, 3) of :meth:`robot` to first order, for ``R`` (3, 3) of the detected pose."""
        marker = out_of_frame(detected, self.detector)
        x, y, theta = robot_at_dock(out_of_frame(self.docked, marker))
        offset_x, offset_y, _ = out_of_frame(self.docked, Pose(0.0, 0.0, marker.theta))
        # Of the docked robot in the robot's frame by the detected x, y, theta ...
        c, s = math.cos(self.detector.theta), math.sin(self.detector.theta)
        by_detected = np.array(((c, -s, -offset_y), (s, c, offset_x), (0.0, 0.0, 1.0)))
        # ... and of the robot in the dock's frame by that.
        c, s = math.cos(theta), math.sin(theta)
        by_docked = np.array(((-c, s, y), (-s, -c, -x), (0.0, 0.0, -1.0)))
        J = by_docked @ by_detected
        covariance: NDArray[np.float64] = J @ R @ J.T
        return covariance
