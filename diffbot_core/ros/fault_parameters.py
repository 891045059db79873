"""Parameters of every node that moves the robot or estimates its pose, about internal errors; free of ROS."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from diffbot_core.schema import Spec


class FaultConfig(NamedTuple):
    """What a node does after an internal error."""

    exit_on_error: Annotated[
        bool, Spec("after an internal error, end with status 1; false: stop the robot and go on")
    ] = False
