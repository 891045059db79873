"""Parameter of the nodes that publish or obey cmd_vel, about others that publish it, too; free of ROS."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from diffbot_core.schema import Spec


class CommandSourceConfig(NamedTuple):
    """Who may command the robot."""

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
