"""Time stamps of streams of messages: whether they advance, how late messages arrive, and whether clocks agree."""

from __future__ import annotations

import math
from collections import deque

NS_PER_S = 1_000_000_000
"""nanoseconds in a second, exact"""
S_PER_NS = 1e-9
"""seconds in a nanosecond"""
RESTART_GAP = NS_PER_S
"""[ns] a stamp further back than this means that time was restarted, a closer one that a message is out of order"""
_MEMORY = 2.0
"""[s] of messages, and at most twice as much, whose smallest age is the usual one"""
_MIN_STEP = 0.1
"""[s] by which a message has to come earlier than all others before it shows that its clock was set forward"""


class StampWatch:
    """Follows the stamps of one stream, to detect a sender that repeats its newest message."""

    def __init__(self) -> None:
        """Start without a stamp."""
        self.newest: int | None = None
        """[ns]"""
        self._behind: int | None = None
        """[ns] the message before, if it was behind the newest one"""

    def advances(self, stamp: int) -> bool:
        """Add the stamp [ns] of a message; return True if it is later than all earlier ones, or the first one.

        After time was restarted, as by a simulation, it advances from the second message on. After the clock was set
        back by less than RESTART_GAP it advances from the third one on.
        """
        newest, behind = self.newest, self._behind
        if newest is None or stamp > newest:
            self.newest, self._behind = stamp, None
            return True
        self._behind = stamp
        if newest - stamp > RESTART_GAP or (behind is not None and stamp > behind):
            self.newest, self._behind = stamp, None
        return False

    def clear(self) -> None:
        """Forget the stamps."""
        self.newest = self._behind = None


class Lateness:
    """Measures how late the messages of one stream arrive, whatever the offset between its clock and the receiver's.

    A sender that was suspended answers old inputs when it resumes. Their stamps advance, but they say nothing about
    the present. The usual age is the smallest age of the last seconds of messages; silence does not reset it.
    """

    def __init__(self) -> None:
        """Start without a message."""
        self._stamp = 0
        self._smallest = self._smallest_before = math.inf
        """[s] smallest age in the present window, and in the previous one"""
        self._since = -math.inf
        """[s] start of the present window"""
        self.early = 0.0
        """[s] by how much the newest message was younger than all others of the last seconds"""

    def next(self, stamp: int, now: float) -> float:
        """Return by how much [s] a message is older than usual at its arrival.

        Args:
            stamp: [ns] of the message; one that is earlier than the last means that time was restarted.
            now: [s] time of arrival on the steady clock.
        """
        age = now - stamp * S_PER_NS
        usual = min(self._smallest, self._smallest_before)
        self.early = max(usual - age, 0.0) if usual < math.inf else 0.0
        if stamp < self._stamp:
            self._smallest = math.inf
        if stamp < self._stamp or now - self._since > _MEMORY:
            self._smallest_before, self._smallest, self._since = self._smallest, age, now
        self._stamp, self._smallest = stamp, min(self._smallest, age)
        return age - min(self._smallest, self._smallest_before)


class ForwardSteps:
    """Detects that the clock of a sender was set forward, so that its stamps advance by more than the time passes."""

    def __init__(self) -> None:
        """Start without a message."""
        self._lateness = Lateness()
        self._stamp: int | None = None
        self._period = 0.0
        """[s] between the last two messages whose clock was not set meanwhile"""

    def passed(self, stamp: int, now: float) -> float:
        """Return the time [s] since the message before if the clock was set forward meanwhile; otherwise inf.

        Args:
            stamp: [ns] of the message.
            now: [s] time of arrival on the steady clock.
        """
        if self._stamp is not None and 0 <= self._stamp - stamp <= RESTART_GAP:
            return math.inf  # out of order
        self._lateness.next(stamp, now)
        since = 0.0 if self._stamp is None else (stamp - self._stamp) * S_PER_NS
        self._stamp = stamp
        # Messages that were held up come early as well, when the delay ends, but their stamps advance as usual.
        if self._lateness.early <= _MIN_STEP or since <= self._period + _MIN_STEP:
            self._period = max(since, 0.0)
            return math.inf
        return max(since - self._lateness.early, self._period)


class RelativeClocks:
    """Compares the clocks that stamp several inputs.

    The smallest age of the messages of an input is its smallest delay, plus the offset of its clock to the receiver's.
    Ages are compared in windows of time, which the caller ends. An offset counts if two windows in a row show it, so
    that a step of a clock, or a delay of the receiver, is not taken for an offset.
    """

    def __init__(self) -> None:
        """Start without a message."""
        self._window: dict[str, int] = {}
        """[ns] smallest age in the present window, by input"""
        self._ages: dict[str, deque[int]] = {}
        """[ns] smallest ages in the two newest windows that had messages"""

    def add(self, name: str, stamp: int, now: int) -> None:
        """Add the stamp [ns] of a message of the input ``name``, received at ``now`` [ns] on any one clock."""
        age = now - stamp
        self._window[name] = min(self._window.get(name, age), age)

    def end_window(self) -> None:
        """End the present window; those of a few seconds have messages of each input."""
        for name, age in self._window.items():
            self._ages.setdefault(name, deque(maxlen=2)).append(age)
        self._window.clear()

    def ahead_of(self, reference: str) -> dict[str, float]:
        """Return by how much [s] the stamps of each other input are ahead of those of ``reference``."""
        found, base = {}, self._ages.get(reference, ())
        for name, ages in self._ages.items():
            if name == reference or min(len(ages), len(base)) < 2:
                continue
            offsets = [(of_base - age) * S_PER_NS for of_base, age in zip(base, ages, strict=True)]
            found[name] = min(offsets, key=abs) if offsets[0] * offsets[1] > 0.0 else 0.0
        return found
