"""Silence of the pose on the steady clock, and whether the node's clock is fit to drive by."""

from __future__ import annotations

import math
import time
from typing import TYPE_CHECKING

from diffbot_core.ros.clock_watch import ClockWatch
from diffbot_core.stamps import StampWatch

if TYPE_CHECKING:
    from diffbot_control.ros.parameters.controller import ControllerNodeConfig


class PoseWatch:
    """Watches in real time: the node's own clock may stand still or jump, and its silence would never end."""

    def __init__(self, clock: ClockWatch) -> None:
        """Count silence from now on."""
        self._clock = clock
        self._stamps = StampWatch()
        self._last_input = self._last_pose = self._goal_began = time.monotonic()
        self._goal_number = 0

    def on_pose(self, stamp: int) -> bool:
        """Count silence anew if ``stamp`` [ns] of a pose advances; return whether it does."""
        advances = self._stamps.advances(stamp)
        if advances:
            self._last_input = self._last_pose = time.monotonic()
        return advances

    def on_goal(self) -> None:
        """Count the silence after which a goal is given up anew."""
        self._last_input = time.monotonic()

    def silence(self) -> float:
        """Return the time [s] since the last pose whose stamp advanced, or the last goal."""
        return time.monotonic() - self._last_input

    def goal_age(self, number: int) -> float:
        """Return for how long [s] goal ``number`` has been the newest one; 0 in simulated time, which may be slower."""
        if number != self._goal_number:
            self._goal_number, self._goal_began = number, time.monotonic()
        return 0.0 if self._clock.is_simulated else time.monotonic() - self._goal_began

    def is_stale(self, config: ControllerNodeConfig) -> bool:
        """Return True if the robot must not move: no pose for too long, or a clock that is unfit."""
        return time.monotonic() - self._last_pose > self._timeout(config) or bool(self.clock_problem(config))

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
