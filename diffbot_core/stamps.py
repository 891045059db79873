"""Watch the time stamps of messages, to detect repeated and late messages, and clocks that are set or disagree."""

from __future__ import annotations

import math
from collections import deque

NS_PER_S = 1_000_000_000
"""Nanoseconds per second."""
S_PER_NS = 1e-9
"""Seconds per nanosecond."""
RESTART_GAP = NS_PER_S
"""[ns] A stamp behind the newest stamp by more than this means a restart of time; by less, it is out of order."""
_WINDOW = 2.0
"""[s] The usual age is the smallest age in the present and the previous window of this length."""
_MIN_STEP = 0.1
"""[s] A clock was set forward if a message is younger than all recent messages by more than this."""


class StampWatch:
    """Watches the stamps of one stream, to detect a sender that repeats its newest message."""

    def __init__(self) -> None:
        """Start without a stamp."""
        self.newest: int | None = None
        """[ns]"""
        self._behind: int | None = None
        """[ns] stamp of the previous message if it was behind the newest stamp"""

    def advances(self, stamp: int) -> bool:
        """Add the stamp [ns] of a message; return True if it is the first stamp or later than all previous stamps.

        After a restart of time, as by a simulation, stamps advance from the second message on. After the clock was set
        back by less than RESTART_GAP, they advance from the third message on.
        """
        newest, behind = self.newest, self._behind
        if newest is None or stamp > newest:
            self.newest, self._behind = stamp, None
            return True
        self._behind = stamp
        if newest - stamp > RESTART_GAP or (behind is not None and stamp > behind):
            self.newest, self._behind = stamp, None
        return False


class Lateness:
    """Measures how late the messages of one stream arrive.

    A sender that was suspended answers old inputs when it resumes. The stamps of its messages advance, but the messages
    are outdated. The offset between the sender's and the receiver's clock is not known. So a message is late if it is
    older than usual, where the usual age is the smallest age in the last two windows.
    """

    def __init__(self) -> None:
        """Start without a message."""
        self._stamp = 0
        self._smallest = self._smallest_before = math.inf
        """[s] smallest age in the present window, and in the previous window"""
        self._since = -math.inf
        """[s] start of the present window"""
        self.early = 0.0
        """[s] by how much the newest message was younger than usual"""

    def next(self, stamp: int, now: float) -> float:
        """Add a message; return by how much [s] it is older than usual.

        Args:
            stamp: [ns] stamp of the message; if it is before the previous stamp, time was restarted.
            now: [s] time of arrival on the steady clock.
        """
        age = now - stamp * S_PER_NS
        usual = min(self._smallest, self._smallest_before)
        self.early = max(usual - age, 0.0) if usual < math.inf else 0.0
        if stamp < self._stamp:
            self._smallest = math.inf
        if stamp < self._stamp or now - self._since > _WINDOW:
            self._smallest_before, self._smallest, self._since = self._smallest, age, now
        self._stamp, self._smallest = stamp, min(self._smallest, age)
        return age - min(self._smallest, self._smallest_before)


class ForwardSteps:
    """Detects that the clock of a sender was set forward: a stamp advanced by more than the time that passed."""

    def __init__(self) -> None:
        """Start without a message."""
        self._lateness = Lateness()
        self._stamp: int | None = None
        self._period = 0.0
        """[s] between the last two messages without a change of the clock"""

    def passed(self, stamp: int, now: float) -> float:
        """Return the true time [s] since the previous message if the clock was set forward in between; otherwise inf.

        Args:
            stamp: [ns] stamp of the message.
            now: [s] time of arrival on the steady clock.
        """
        if self._stamp is not None and 0 <= self._stamp - stamp <= RESTART_GAP:
            return math.inf  # out of order
        self._lateness.next(stamp, now)
        since = 0.0 if self._stamp is None else (stamp - self._stamp) * S_PER_NS
        self._stamp = stamp
        # After a delay, messages are early, too, but their stamps advance by the usual period.
        if self._lateness.early <= _MIN_STEP or since <= self._period + _MIN_STEP:
            self._period = max(since, 0.0)
            return math.inf
        return max(since - self._lateness.early, self._period)


class RelativeClocks:
    """Compares the clocks of the senders of several inputs.

    The smallest age of an input's messages is its smallest delay plus the offset between the clocks of sender and
    receiver. The caller divides time into windows. Only an offset that occurs in two windows in a row counts, because a
    step of a clock or a delay of the receiver causes an offset in one window.
    """

    def __init__(self) -> None:
        """Start without a message."""
        self._window: dict[str, int] = {}
        """[ns] smallest age in the present window, by input"""
        self._ages: dict[str, deque[int]] = {}
        """[ns] smallest ages in the two newest windows with messages, by input"""

    def add(self, name: str, stamp: int, now: int) -> None:
        """Add a message of the input ``name`` with its stamp [ns]; ``now`` [ns] is the time of its arrival."""
        age = now - stamp
        self._window[name] = min(self._window.get(name, age), age)

    def end_window(self) -> None:
        """End the present window, which should be long enough for messages of each input."""
        for name, age in self._window.items():
            self._ages.setdefault(name, deque(maxlen=2)).append(age)
        self._window.clear()

    def ahead_of(self, reference: str) -> dict[str, float]:
        """Return, by input, how far [s] the sender's clock is ahead of the clock of the input ``reference``."""
        found, base = {}, self._ages.get(reference, ())
        for name, ages in self._ages.items():
            if name == reference or min(len(ages), len(base)) < 2:
                continue
            offsets = [(of_base - age) * S_PER_NS for of_base, age in zip(base, ages, strict=True)]
            found[name] = min(offsets, key=abs) if offsets[0] * offsets[1] > 0.0 else 0.0
        return found
