"""The robot's pose in the frame of a dock that it sees: a detection turned round. Pure functions of floats.

The dock's frame has its origin where the robot stands when it is docked, and the robot's heading then as x axis. A
filter in this frame needs no pose in map, so a relocation there does not move the dock; between detections, and when
there are none any more, it goes on by odometry, and its covariance says how far that can be trusted.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from diffbot_core.geometry import Pose, into_frame


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
