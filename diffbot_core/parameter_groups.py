"""Groups of parameters that several nodes share."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from diffbot_core.schema import Spec


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
