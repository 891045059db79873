"""Corrections of the present goal on the topic goal_update, which Nav2's goal updater has given its name."""

from __future__ import annotations

from typing import TYPE_CHECKING

from diffbot_control.ros.goals.server import GoalServer
from diffbot_core.errors import BadMessageError
from diffbot_core.geometry import Pose
from diffbot_core.ros.node import DiffbotNode
from diffbot_core.stamps import StampWatch
from diffbot_core.units import S_PER_NS

if TYPE_CHECKING:
    from diffbot_control.ros.parameters.controller import ControllerNodeConfig

TOPIC = "goal_update"
WITHOUT_GOAL = f"{TOPIC} without a goal"
"""Key in /diagnostics: a detector may see its dock all day."""


class GoalUpdates:
    """Takes corrections that are new: what sends the same one again may have stopped seeing the goal."""

    def __init__(self, node: DiffbotNode[ControllerNodeConfig], goals: GoalServer) -> None:
        """Begin without a correction."""
        self._node, self._goals = node, goals
        self._stamps = StampWatch()

    def take(self, stamp: int, goal: Pose) -> None:
        """Correct the present goal.

        Args:
            stamp: [ns] time at which the goal was seen there; 0: unknown.
            goal: in ``map_frame``.

        Raises:
            BadMessageError: if it is no later than the one before, too old, or too far from the present goal.
        """
        if stamp:
            timeout = self._node.config.supervisor.updates.goal_update_timeout
            age = self._node.clock_watch.now() - stamp * S_PER_NS
            if age > timeout:
                raise BadMessageError("stamp too old", f"{age:.3g} s, goal_update_timeout = {timeout:g} s")
            if not self._stamps.advances(stamp):
                raise BadMessageError("stamp not later than the one before")
        self._goals.supervisor.on_goal_update(goal)
