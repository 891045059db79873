"""Silence of the pose on the steady clock, and whether the node's clock is fit to drive by."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import TYPE_CHECKING

from diffbot_core.ros.clock_watch import ClockWatch
from diffbot_core.stamps import Lateness, StampWatch

if TYPE_CHECKING:
    from diffbot_control.ros.parameters.controller import ControllerNodeConfig


class PoseWatch:
    """Watches in real time: the node's own clock may stand still or jump, and its silence would never end."""

    def __init__(self, clock: ClockWatch, steady: Callable[[], float] = time.monotonic) -> None:
        """Count silence from now on; ``steady`` returns the time [s] on the steady clock."""
        self._clock, self._steady = clock, steady
        self._stamps, self._lateness = StampWatch(), Lateness()
        self._last_input = self._last_pose = self._goal_began = steady()
        self._goal_number = 0

    def on_pose(self, stamp: int) -> bool:
        """Count silence anew if ``stamp`` [ns] of a pose advances; return whether it does.

        The robot may move until ``pose_timeout`` after the time at which the pose would usually have arrived.
        """
        advances = self._stamps.advances(stamp)
        if advances:
            self._last_input = now = self._steady()
            # Simulated time may be slower than the steady clock.
            late = 0.0 if self._clock.is_simulated else self._lateness.next(stamp, now)
            self._last_pose = max(self._last_pose, now - late)
        return advances

    def on_goal(self) -> None:
        """Count the silence after which a goal is given up anew."""
        self._last_input = self._steady()

    def silence(self) -> float:
        """Return the time [s] since the last pose whose stamp advanced, or the last goal."""
        return self._steady() - self._last_input

    def goal_age(self, number: int) -> float:
        """Return for how long [s] goal ``number`` has been the newest one; 0 in simulated time, which may be slower."""
        if number != self._goal_number:
            self._goal_number, self._goal_began = number, self._steady()
        return 0.0 if self._clock.is_simulated else self._steady() - self._goal_began

    def is_stale(self, config: ControllerNodeConfig) -> bool:
        """Return True if the robot must not move: none or only late poses for too long, or an unfit clock."""
        return self._steady() - self._last_pose > self._timeout(config) or bool(self.clock_problem(config))

    def clock_problem(self, config: ControllerNodeConfig) -> str:
        """Return why the clock is not fit to drive by, empty if it is."""
        if self._clock.is_unreliable:
            return self._clock.problem or "time on /clock jumped back"
        return "time on /clock stands still" if self._clock.standstill() > self._timeout(config) else ""

    def _timeout(self, config: ControllerNodeConfig) -> float:
        timeout = config.supervisor.pose_timeout
        if not self._clock.is_simulated:
            return timeout
        # In lock-step the plant waits for the answer, however long that takes in real time.
        return math.inf if config.supervisor.publish_when_idle else timeout * config.real_timeout_factor
