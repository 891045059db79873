"""When the plant takes its next step: by a clock, or by the answers of the controller (lock-step). Free of ROS."""

from __future__ import annotations

import math

WALL, SCALED, LOCKSTEP = "wall", "scaled", "lockstep"
CLOCKS = (WALL, SCALED, LOCKSTEP)

_CATCH_UP_MOST = 5
_EARLY = 0.1
"""Share of the period by which a timer may fire early: it jitters, and a step put off would come with the next."""


class ClockPace:
    """Steps due by a steady clock; a late caller catches up a few steps, a very late one skips the rest."""

    def __init__(self, period: float, now: float) -> None:
        """Begin at ``now`` [s]; a step is due each ``period`` [s] of the steady clock."""
        self.period = period
        self.skipped = 0
        """steps left out because nobody asked in time"""
        self._next = now + period

    def restart(self, now: float) -> None:
        """Begin anew, after a pause."""
        self._next = now + self.period

    def due(self, now: float) -> int:
        """Return how many steps to take now."""
        count = math.floor((now - self._next) / self.period + _EARLY) + 1
        if count < 1:
            return 0
        self._next += count * self.period
        if count > _CATCH_UP_MOST:
            self.skipped += count - _CATCH_UP_MOST
            return _CATCH_UP_MOST
        return count


class LockStep:
    """Counts questions (a step's messages sent) and answers (commands received) of one step.

    A command carries no mark of the step it answers. If a step's messages had to be sent twice, two answers may come,
    and taking the second for the answer to the next step would leave the loop one step behind for good; so a step
    ends when all its questions are answered, or one is and no more come.

    DDS keeps no order between topics for one who was away or has just come: the answer may not know all that was
    measured at its step. Such a step is in doubt; it is asked again ``DOUBTS`` times, one after the other, and the last
    answer counts.
    """

    DOUBTS = 10
    """As many as the queues hold: a publisher whose queue is full asks its readers with each message what they lack."""

    def __init__(self) -> None:
        """Start with nothing asked."""
        self.asked = 0
        self.answered = 0
        self.doubts = 0
        """how often the present step is still to be asked again"""
        self.repeats = 0
        """questions sent again because no answer came, over all steps"""

    @property
    def complete(self) -> bool:
        """Whether something was asked and all of it is answered."""
        return 0 < self.asked <= self.answered

    def ask(self) -> None:
        """Note that the messages of the present step were sent."""
        self.asked += 1

    def answer(self) -> None:
        """Note a command; one that answers nothing is passed over."""
        if self.asked > 0:
            self.answered += 1

    def stalled(self) -> bool:
        """Nothing came for long: True if what came completes the step, False if the messages are to be sent again."""
        if self.answered > 0:
            self.asked = min(self.asked, self.answered)
            return True
        self.repeats += 1
        self.doubt()
        return False

    def doubt(self) -> None:
        """Put the present step in doubt."""
        self.doubts = self.DOUBTS

    def ask_once_more(self) -> bool:
        """Whether the complete step is to be asked again; then its questions begin anew, with one doubt less."""
        if self.doubts == 0:
            return False
        self.doubts -= 1
        self.asked = self.answered = 0
        return True

    def next_step(self) -> None:
        """Forget the finished step."""
        self.asked = self.answered = self.doubts = 0
