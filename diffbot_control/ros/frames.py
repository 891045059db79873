"""Names of the frames of a robot, which begin with its ``frame_prefix``, and texts of parameters of several nodes."""

from __future__ import annotations

from typing import Any

from diffbot_core.errors import InvalidValueError

PREFIX_TEXT = "prefix of odom_frame and base_link_frame, such as robot1/; map_frame has no prefix"
RELIABLE_TEXT = "receive sensor data from reliable publishers only, so that no message is lost (lock-step needs it)"


def robot_frame(config: Any) -> str:
    """Return ``base_link_frame`` of a configuration with its prefix.

    Raises:
        InvalidValueError: if the prefix begins with a slash.
    """
    return _prefixed(config.frame_prefix, config.base_link_frame)


def odometry_frame(config: Any) -> str:
    """Return ``odom_frame`` of a configuration with its prefix.

    Raises:
        InvalidValueError: if the prefix begins with a slash.
    """
    return _prefixed(config.frame_prefix, config.odom_frame)


def _prefixed(prefix: str, frame: str) -> str:
    if prefix.startswith("/"):
        # tf2 refuses frames with a leading slash.
        raise InvalidValueError("frame_prefix", prefix, "without a leading slash")
    return prefix + frame
