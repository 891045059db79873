"""Parameters of the node ``controller`` about its goal after a restart; free of ROS."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from diffbot_core.errors import InvalidValueError
from diffbot_core.schema import Spec


class RestartConfig(NamedTuple):
    """What becomes of the goal when the controller is started again after it was killed or has failed."""

    goal_file: Annotated[
        str,
        Spec(
            "file that keeps the present goal across a restart, relative to the working folder; empty: none",
            read_only=True,
        ),
    ] = ""
    resume_goal: Annotated[
        bool,
        Spec(
            "after a restart, drive on to the goal in goal_file; false: give it up, and report that to its client",
            read_only=True,
        ),
    ] = False
    resume_timeout: Annotated[
        float,
        Spec(
            "longest absence of the controller after which a goal is resumed; later, the goal is given up",
            "s",
            minimum=0.0,
            maximum=1e6,
            read_only=True,
        ),
    ] = 30.0

    def check(self) -> None:
        """Refuse to resume a goal that is kept nowhere.

        Raises:
            InvalidValueError: if ``resume_goal`` is set without ``goal_file``.
        """
        if self.resume_goal and not self.goal_file:
            raise InvalidValueError("resume_goal", self.resume_goal, "false without a goal_file")
