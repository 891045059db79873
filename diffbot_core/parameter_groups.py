"""Groups of parameters that several nodes have."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from diffbot_core.schema import Spec


class CommandSourceConfig(NamedTuple):
    """Who may command the robot; for nodes that publish or obey cmd_vel."""

    max_cmd_vel_publishers: Annotated[
        int,
        Spec(
            "publishers of cmd_vel, the controller included, beyond which /diagnostics reports an ERROR; 2 with a"
            " teleoperation that shares the topic",
            "-",
            1,
            100,
            read_only=True,
        ),
    ] = 1


class FaultConfig(NamedTuple):
    """What a node does after an internal error; for nodes that move the robot or estimate its pose."""

    exit_on_error: Annotated[
        bool, Spec("after an internal error, end with status 1; false: stop the robot and go on")
    ] = False


class LifecycleConfig(NamedTuple):
    """Who takes a managed node through its states."""

    autostart: Annotated[
        bool, Spec("the node configures and activates itself; false: a lifecycle manager does", read_only=True)
    ] = True
