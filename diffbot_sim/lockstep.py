"""The lock-step protocol: the simulated robot takes a step when the controller has answered the present one.

Free of ROS: :class:`LockStep` decides when a step is sent and when the robot moves; a :class:`Plant` does it. The stamp
of a TwistStamped names the pose that it answers, so an answer to another step is ignored. The filter's inputs of a step
are sent before its odometry, which the filter answers.

A node that does not answer must not stop the simulation for ever: after a stall the robot moves on with zero command.
"""

from __future__ import annotations

from typing import Protocol

from diffbot_core.kinematics import Twist

SETTLED_POLLS = 10
"""Polls in a row that must find the same neighbours: the two ends of a connection learn of it at different times."""
STALLED_CHECKS = 5
"""Checks in a row without an answer after which the robot moves on; from then on each check, until an answer comes."""
MAX_STEPS_WITHOUT_FIX = 1000
"""Steps for which a late or lost first fix is awaited."""
_STEPS_PER_POLL = 5
"""Steps taken in one poll while the first fix is awaited."""
NO_FILTER, NO_FIX, NO_COMMAND = "no filter", "no fix", "no command"
"""What LockStep reports: no filter is connected; no fix came in MAX_STEPS_WITHOUT_FIX steps; a step is unanswered."""
_STOP = Twist(0.0, 0.0)


class Plant(Protocol):
    """What the protocol needs of the simulated robot and its connections."""

    @property
    def step(self) -> int:
        """Number of the present step."""

    @property
    def stamp(self) -> int:
        """Time [ns] of the present step."""

    def advance(self, command: Twist) -> None:
        """Hold ``command`` for one step."""

    def publish(self) -> None:
        """Send all messages of the present step; the filter and then the controller answer the last of them."""

    def publish_truth(self) -> None:
        """Send only time and true state of the present step, which get no answer."""

    def awaits_first_fix(self) -> bool:
        """True if there are fixes, and none arrives at the present step."""

    def connections(self) -> tuple[int, ...] | None:
        """How many nodes are connected to each topic; None until a filter is connected to all that it needs."""

    def report(self, event: str) -> None:
        """Log NO_FILTER, NO_FIX or NO_COMMAND."""


class LockStep:
    """Sends steps and moves the plant; to be called when a command arrives, and by two timers."""

    def __init__(self, plant: Plant, *, paused: bool = False) -> None:
        """Wait for a filter; :meth:`on_poll` is to be called periodically from now on."""
        self._plant, self._paused = plant, paused
        self._answer: Twist | None = None
        self.is_started = False
        """the first step was sent"""
        self._connections: tuple[int, ...] | None = None
        self._settled_polls = self._checks = 0
        self._stalls = False
        self.unanswered = 0
        """steps that no command answered"""

    def on_command(self, command: Twist, stamp: int) -> None:
        """Take the controller's answer to the pose of ``stamp`` [ns]."""
        if self.is_started and stamp == self._plant.stamp:
            self._answer, self._stalls = command, False
            self._advance_if_answered()

    def on_poll(self) -> None:
        """Before the first step, look for a filter and for its first fix."""
        if self.is_started:
            return
        before, self._connections = self._connections, self._plant.connections()
        settled = self._connections is not None and self._connections == before
        self._settled_polls = self._settled_polls + 1 if settled else 0
        if not self._paused:
            self._try_to_start()

    def on_stall_check(self) -> None:
        """Move on with zero command if no answer has come for some checks; to be called about once a second."""
        if self._paused or not self.is_started or self._answer is not None:
            self._checks = 0
            return
        self._checks += 1
        if self._checks >= STALLED_CHECKS or self._stalls:
            self.unanswered += 1
            self._stalls = True
            self._plant.report(NO_COMMAND)
            self._answer = _STOP
            self._advance_if_answered()

    def set_paused(self, paused: bool) -> None:
        """Hold the robot at the present step, or let it go on."""
        self._paused = paused
        self._advance_if_answered()

    def reset(self) -> None:
        """Start again, with the plant at its first step: wait for connections to settle and for the first fix."""
        self._settled_polls, self._answer, self.is_started, self._stalls = 0, None, False, False

    def _try_to_start(self) -> None:
        """Send the first step once a filter is connected and has a fix to start from.

        A first fix that the filter misses would give a different run. While it is late only time passes: without a pose
        the filter cannot answer odometry.
        """
        if self._settled_polls < SETTLED_POLLS:
            self._plant.report(NO_FILTER)
            return
        for _ in range(_STEPS_PER_POLL):
            if self._plant.awaits_first_fix():
                if self._plant.step < MAX_STEPS_WITHOUT_FIX:
                    self._plant.publish_truth()
                    self._plant.advance(_STOP)
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
