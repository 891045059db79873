"""Names of frames: the frames of a robot begin with its ``frame_prefix``; ``map`` is common to all. Free of ROS."""

from __future__ import annotations

from typing import Any

from diffbot_core.errors import InvalidValueError

PREFIX_TEXT = "put before odom_frame and base_link_frame, such as robot1/; map_frame is common to all robots"

RELIABLE_TEXT = "receive sensors from reliable publishers only, without a loss (lock-step needs it)"


def robot_frame(config: Any) -> str:
    """Return the full name of ``base_link_frame`` of a node's configuration.

    Raises:
        InvalidValueError: see :func:`prefixed`.
    """
    return prefixed(config.frame_prefix, config.base_link_frame)


def odometry_frame(config: Any) -> str:
    """Return the full name of ``odom_frame`` of a node's configuration.

    Raises:
        InvalidValueError: see :func:`prefixed`.
    """
    return prefixed(config.frame_prefix, config.odom_frame)


def prefixed(prefix: str, frame: str) -> str:
    """Return the name of a robot's frame; the prefix is used as it is, as robot_state_publisher does.

    Raises:
        InvalidValueError: if the prefix begins with a slash, which tf2 does not allow.
    """
    if prefix.startswith("/"):
        raise InvalidValueError("frame_prefix", prefix, "without a slash at its beginning")
    return prefix + frame
