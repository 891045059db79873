"""Parameters that several nodes share: groups, texts, and the names of the robot's frames."""

from __future__ import annotations

from typing import Annotated, Any, NamedTuple

from diffbot_core.errors import InvalidValueError
from diffbot_core.schema import Spec

PREFIX_TEXT = "prefix of odom_frame and base_link_frame, such as robot1/; map_frame has no prefix"
RELIABLE_TEXT = "receive sensor data from reliable publishers only, so that no message is lost (lock-step needs it)"


class CommandSourceConfig(NamedTuple):
    """Number of publishers of cmd_vel, for nodes that publish cmd_vel or subscribe to it."""

    max_cmd_vel_publishers: Annotated[
        int,
        Spec(
            "largest number of publishers of cmd_vel, including the controller; /diagnostics reports an ERROR if there"
            " are more; use 2 with teleoperation on the same topic",
            "-",
            1,
            100,
            read_only=True,
        ),
    ] = 1


class FaultConfig(NamedTuple):
    """Reaction to internal errors, for nodes that move the robot or estimate its pose."""

    exit_on_error: Annotated[
        bool, Spec("after an internal error, end with status 1; false: stop the robot and continue")
    ] = False


class LifecycleConfig(NamedTuple):
    """Start of a managed node."""

    autostart: Annotated[
        bool, Spec("the node configures and activates itself; false: a lifecycle manager does", read_only=True)
    ] = True


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
