"""Goals of the topic goal_pose at a bounded rate: a flood of them leaves the controller time to answer poses."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from diffbot_core.geometry import Pose
from diffbot_core.ros.node import DiffbotNode

TOPIC = "goal_pose"
PERIOD = 0.05
"""[s] between two goals of a flood; to accept one, and to announce how the last one ended, takes about 3 ms"""
BURST = 10
"""goals that are accepted at once after a pause"""
SUPERSEDED = f"{TOPIC} superseded by the next one"
"""Key in /diagnostics of the goals that were never accepted."""


class GoalIntake:
    """Accepts goals at once; of those that come faster than one each PERIOD, the newest one."""

    def __init__(
        self, node: DiffbotNode[Any], accept: Callable[[Pose], None], clock: Callable[[], float] = time.monotonic
    ) -> None:
        """Create the timer of a goal that has to wait; ``accept`` receives the goals, ``clock`` is a steady one [s]."""
        self._node, self._accept, self._clock = node, accept, clock
        self._waiting: Pose | None = None
        self._busy_until = clock()
        """time [s] until which the accepted goals use up the rate"""
        self._timer = node.create_timer(PERIOD, self._accept_waiting, clock=node.steady_clock)
        self._timer.cancel()

    def take(self, goal: Pose) -> None:
        """Accept a goal, now or within PERIOD; the newest goal wins."""
        now = self._clock()
        if self._waiting is not None:
            self._node.health.counted[SUPERSEDED] += 1
        elif self._busy_until - now < (BURST - 0.5) * PERIOD:
            self._busy_until = max(self._busy_until, now) + PERIOD
            self._accept(goal)
            return
        else:
            self._timer.reset()
        self._waiting = goal

    def drop(self) -> bool:
        """Forget the goal that waits; return whether there was one."""
        was_waiting = self._waiting is not None
        self._waiting = None
        self._timer.cancel()
        return was_waiting

    def _accept_waiting(self) -> None:
        goal = self._waiting
        self.drop()
        if goal is not None:
            self._busy_until = max(self._busy_until, self._clock()) + PERIOD
            self._accept(goal)
