"""Lock-step protocol: the simulated robot moves when the controller has answered the present step.

This module does not use ROS. :class:`LockStep` decides when a step is sent and when the robot moves. A :class:`Plant`
sends the messages and moves the robot. The stamp of a TwistStamped is the stamp of the pose that it answers, so answers
to other steps are ignored. The plant sends the odometry of a step last, since the filter answers it.

If a node does not answer, the robot moves on with zero command after some seconds. Otherwise the simulation would stop.
"""

from __future__ import annotations

from typing import Protocol

from diffbot_core.kinematics import STOP, Twist

SETTLED_POLLS = 50
"""Polls in a row that must find the same connections: DDS reports a connection to its two ends at different times."""
STALLED_CHECKS = 5
"""Checks in a row without an answer before the robot moves on. Until the next answer, it then moves at each check."""
MAX_STEPS_WITHOUT_FIX = 1000
"""Steps after which the robot no longer waits for its first fix."""
_STEPS_PER_POLL = 5
"""Steps in one poll while the robot waits for its first fix."""
NO_FILTER, NO_FIX, NO_COMMAND = "no filter", "no fix", "no command"
"""Events: no filter is connected; no fix arrived in MAX_STEPS_WITHOUT_FIX steps; the controller did not answer."""


class Plant(Protocol):
    """Simulated robot and connections, as the protocol uses them."""

    @property
    def step(self) -> int:
        """Return the number of the present step."""

    @property
    def stamp(self) -> int:
        """Return the time [ns] of the present step."""

    def advance(self, command: Twist) -> None:
        """Hold ``command`` for one step."""

    def publish(self) -> None:
        """Send all messages of the present step. The filter answers the last message.

        The controller answers the pose of the filter.
        """

    def publish_truth(self) -> None:
        """Send only time and true state of the present step, which no node answers."""

    def awaits_first_fix(self) -> bool:
        """Return True if the plant sends fixes, but no fix arrives at the present step."""

    def connections(self) -> tuple[int, ...] | None:
        """Return the number of connections of each topic; None until a filter is connected to all topics it needs."""

    def report(self, event: str) -> None:
        """Log NO_FILTER, NO_FIX or NO_COMMAND."""


class LockStep:
    """State of the protocol. Its owner calls the methods for each command and from two timers."""

    def __init__(self, plant: Plant, *, paused: bool = False) -> None:
        """Wait for a filter. A timer has to call :meth:`on_poll` from now on."""
        self._plant, self._paused = plant, paused
        self._answer: Twist | None = None
        self.is_started = False
        """True once the first step is sent"""
        self._connections: tuple[int, ...] | None = None
        self._settled_polls = self._checks = 0
        self._stalls = False
        self.unanswered = 0
        """number of steps without an answer"""

    def on_command(self, command: Twist, stamp: int) -> None:
        """Move the robot if the command answers the pose of the present step; ``stamp`` in ns."""
        if self.is_started and stamp == self._plant.stamp:
            self._answer, self._stalls = command, False
            self._advance_if_answered()

    def on_poll(self) -> None:
        """Check the connections, and send the first step when a filter is connected and the first fix arrives."""
        if self.is_started:
            return
        before, self._connections = self._connections, self._plant.connections()
        settled = self._connections is not None and self._connections == before
        self._settled_polls = self._settled_polls + 1 if settled else 0
        if not self._paused:
            self._try_to_start()

    def on_stall_check(self) -> None:
        """Move the robot with zero command if several checks found no answer. A timer calls this once per second."""
        if self._paused or not self.is_started or self._answer is not None:
            self._checks = 0
            return
        self._checks += 1
        if self._checks >= STALLED_CHECKS or self._stalls:
            self.unanswered += 1
            self._stalls = True
            self._plant.report(NO_COMMAND)
            self._answer = STOP
            self._advance_if_answered()

    def set_paused(self, paused: bool) -> None:
        """Pause or resume the simulation."""
        self._paused = paused
        self._advance_if_answered()

    def reset(self) -> None:
        """Start again with the plant at its first step: wait for stable connections and for the first fix."""
        self._settled_polls, self._answer, self.is_started, self._stalls = 0, None, False, False
        self.unanswered = 0

    def _try_to_start(self) -> None:
        """Send the first step if a filter is connected and the first fix arrives.

        The connections must be stable first, because losing the first fix would change the run. Until the first fix,
        the plant sends no odometry, because a filter without a pose cannot answer it.
        """
        if self._settled_polls < SETTLED_POLLS:
            self._plant.report(NO_FILTER)
            return
        for _ in range(_STEPS_PER_POLL):
            if self._plant.awaits_first_fix():
                if self._plant.step < MAX_STEPS_WITHOUT_FIX:
                    self._plant.publish_truth()
                    self._plant.advance(STOP)
                    continue
                self._plant.report(NO_FIX)
            self.is_started = True
            self._send()
            return

    def _advance_if_answered(self) -> None:
        if self._answer is not None and not self._paused:
            self._plant.advance(self._answer)
            self._send()

    def _send(self) -> None:
        self._answer, self._checks = None, 0
        self._plant.publish()
