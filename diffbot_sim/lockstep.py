"""The lock-step protocol: the simulated robot takes a step when the controller has answered the previous one.

Free of ROS: :class:`LockStep` decides when a step is sent and when the robot moves; a :class:`Plant` does it.

A command does not name the step it answers. If the messages of a step had to be sent twice, two answers may come, and
counting the second as the answer to the next step would leave the loop one step behind for good. So a step ends when
each sending of its messages is answered, or when at least one is and no more answers come.

DDS keeps no order between topics for a node that was away or has just joined: it may have answered before all
measurements of the step arrived. Such a reply may be stale; the step is sent again ``RESENDS`` times, one after the
other, and the last answer counts.
"""

from __future__ import annotations

from typing import Protocol

from diffbot_core.kinematics import Twist

RESENDS = 10
"""Times that a step is sent again if its reply may be stale.

As many as the queues hold: with each message, a publisher with a full queue asks its readers what they lack.
"""
SETTLED_POLLS = 10
"""Polls in a row that must find the same neighbours: the two ends of a connection learn of it at different times."""
MAX_STEPS_WITHOUT_FIX = 1000
"""Steps for which a late or lost first fix is awaited."""
STEPS_PER_POLL = 5
"""Steps taken in one poll while the first fix is awaited."""
NO_FILTER, NO_FIX, NO_COMMAND = "no filter", "no fix", "no command"
"""What LockStep reports: no filter is connected; no fix came in MAX_STEPS_WITHOUT_FIX steps; a step is unanswered."""
_STOP = Twist(0.0, 0.0)


class Plant(Protocol):
    """What the protocol needs of the simulated robot and its connections."""

    @property
    def step(self) -> int:
        """Number of the present step."""

    def advance(self, command: Twist) -> None:
        """Hold ``command`` for one step."""

    def publish(self) -> None:
        """Send all messages of the present step; the filter and then the controller answer the last of them."""

    def publish_truth(self) -> None:
        """Send only time and true state of the present step, which get no answer."""

    def awaits_first_fix(self) -> bool:
        """True if there are fixes, and none arrives at the present step."""

    def optional_topics(self) -> set[str]:
        """Topics with a message at the present step that the filter can answer without."""

    def connections(self) -> tuple[int, ...] | None:
        """How many nodes are connected to each topic; None until a filter is connected to all that it needs."""

    def set_polling(self, active: bool) -> None:
        """Start or stop the periodic calls of :meth:`LockStep.on_poll`."""

    def report(self, event: str) -> None:
        """Tell the user of NO_FILTER, NO_FIX or NO_COMMAND."""


class Answers:
    """Counts the sendings of one step's messages, and the commands that answer them."""

    def __init__(self) -> None:
        """Start with nothing sent."""
        self.sent = 0
        self.received = 0
        self.resends = 0
        """how often the present step is still to be sent again because its reply may be stale"""
        self.repeats = 0
        """sendings repeated because no answer came, over all steps"""

    @property
    def complete(self) -> bool:
        """True if the step was sent and every sending is answered."""
        return 0 < self.sent <= self.received

    @property
    def conclusive(self) -> bool:
        """True if the step is complete and its reply is up to date."""
        return self.complete and self.resends == 0

    def count_sending(self) -> None:
        """Count a sending of the present step."""
        self.sent += 1

    def count_command(self) -> None:
        """Count a command."""
        self.received += 1

    def settle(self) -> bool:
        """Handle a silence: True if the answers so far complete the step, False if it must be sent again."""
        if self.received > 0:
            self.sent = min(self.sent, self.received)
            return True
        self.repeats += 1
        self.require_resends()
        return False

    def require_resends(self) -> None:
        """Mark the reply to the present step as possibly stale."""
        self.resends = RESENDS

    def begin_resend(self) -> None:
        """Begin one of the required resends: only its own answer completes the step."""
        self.resends -= 1
        self.sent = self.received = 0

    def begin_step(self) -> None:
        """Forget the finished step."""
        self.sent = self.received = self.resends = 0


class LockStep:
    """Sends steps and moves the plant; to be called when a command arrives, and by two timers."""

    def __init__(self, plant: Plant, *, paused: bool = False) -> None:
        """Wait for a filter; ``on_poll`` is to be called periodically from now on."""
        self._plant = plant
        self._paused = paused
        self._answers = Answers()
        self._command = _STOP
        self._started = False
        self._progressed = False
        """True if anything was sent or received since the last stall check"""
        self._connections: tuple[int, ...] | None = None
        self._settled_polls = 0
        self._topics_sent: set[str] = set()

    @property
    def repeats(self) -> int:
        """Sendings repeated because no answer came."""
        return self._answers.repeats

    def on_command(self, command: Twist) -> None:
        """Take the controller's answer."""
        self._command = command
        self._progressed = True
        self._answers.count_command()
        self._advance_if_conclusive()

    def on_poll(self) -> None:
        """Look for a filter before the first step; later resend a step whose reply may be stale."""
        if not self._started:
            self._watch_connections()
        if self._paused:
            return
        if not self._started:
            self._try_to_start()
        elif self._answers.resends == 0:
            self._plant.set_polling(False)
        elif self._answers.complete:
            self._answers.begin_resend()
            self._send()

    def on_stall_check(self) -> None:
        """Send the step again if nothing was sent or received since the last call."""
        progressed, self._progressed = self._progressed, False
        if progressed or self._paused or not self._started:
            return
        if self._answers.settle():
            self._advance_if_conclusive()
            return
        self._plant.report(NO_COMMAND)
        self._plant.set_polling(True)
        self._send()
        self._progressed = False

    def set_paused(self, paused: bool) -> None:
        """Hold the robot at the present step, or let it go on."""
        self._paused = paused
        self._advance_if_conclusive()

    def reset(self) -> None:
        """Start again, with the plant at its first step: wait for connections to settle and for the first fix.

        Answers to what was sent before the reset arrive during that wait and are not counted.
        """
        self._answers.begin_step()
        self._started, self._settled_polls = False, 0
        self._topics_sent.clear()
        self._plant.set_polling(True)

    def _watch_connections(self) -> None:
        before, self._connections = self._connections, self._plant.connections()
        settled = self._connections is not None and self._connections == before
        self._settled_polls = self._settled_polls + 1 if settled else 0

    def _try_to_start(self) -> None:
        """Send the first step once a filter is connected and has a fix to start from.

        A first fix that the filter misses would give a different run. While it is late only time passes: without a pose
        the filter cannot answer odometry, and an answer to it after the fix would count for another step.
        """
        if self._settled_polls < SETTLED_POLLS:
            self._plant.report(NO_FILTER)
            return
        for _ in range(STEPS_PER_POLL):
            if self._plant.awaits_first_fix():
                if self._plant.step < MAX_STEPS_WITHOUT_FIX:
                    self._plant.publish_truth()
                    self._plant.advance(_STOP)
                    continue
                self._plant.report(NO_FIX)
            self._plant.set_polling(False)
            self._started = True
            self._begin_step()
            return

    def _advance_if_conclusive(self) -> None:
        """Take the next step if the present one is answered; resends are left to the polls."""
        if self._answers.conclusive and not self._paused:
            self._advance()

    def _advance(self) -> None:
        self._plant.advance(self._command)
        self._begin_step()

    def _begin_step(self) -> None:
        self._answers.begin_step()
        first_sent = self._plant.optional_topics() - self._topics_sent
        if first_sent:
            # The filter may miss the first message of a topic unnoticed and answer without it.
            self._topics_sent |= first_sent
            self._answers.require_resends()
            self._plant.set_polling(True)
        self._send()

    def _send(self) -> None:
        self._progressed = True
        self._answers.count_sending()
        self._plant.publish()
