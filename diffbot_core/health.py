"""Counters of received, dropped and sent messages for /diagnostics, and a log throttle."""

from __future__ import annotations

import math
import time
from collections import Counter, deque
from collections.abc import Hashable

_NEWEST_DROP_MEMORY = 2.0
"""[s] A message dropped within this time is reported as the reason why no messages of its topic are accepted."""
DROP_MEMORY = 10.0
"""[s] A message dropped within this time causes a warning; the counters have no time limit."""
_MAX_RECENT = 10_000
"""Largest number of recent drops that are counted."""


class Health:
    """Counters of one node: accepted and sent messages by topic, dropped messages by topic and reason."""

    def __init__(self) -> None:
        """Start with all counters at zero."""
        self.accepted: Counter[str] = Counter()
        self.sent: Counter[str] = Counter()
        self.dropped: Counter[tuple[str, str]] = Counter()
        self.counted: Counter[str] = Counter()
        """other counters by their key in /diagnostics"""
        self.last_received: dict[str, float] = {}
        """[s] steady time of the newest accepted message by topic"""
        self._newest_drops: dict[str, tuple[float, str]] = {}
        self._reported: Counter[str] = Counter()
        self._drop_times: deque[float] = deque(maxlen=_MAX_RECENT)

    def reset(self) -> None:
        """Set all counters to zero, when the node is reset."""
        for counter in (self.accepted, self.sent, self.dropped, self.counted, self._reported):
            counter.clear()
        self.last_received.clear()
        self._newest_drops.clear()
        self._drop_times.clear()

    def drop(self, topic: str, kind: str, text: str = "") -> bool:
        """Count a dropped message; return True for the first message of its topic and kind, which should be logged.

        Args:
            topic: topic of the message.
            kind: reason under which the message is counted.
            text: reason with details, for :meth:`newest_drop`.
        """
        self._newest_drops[topic] = time.monotonic(), text or kind
        self.dropped[topic, kind] += 1
        self._drop_times.append(time.monotonic())
        return self.dropped[topic, kind] == 1

    def recent_drops(self, now: float) -> int:
        """Return the number of messages dropped in the last DROP_MEMORY seconds; ``now`` [s] is steady time."""
        while self._drop_times and now - self._drop_times[0] > DROP_MEMORY:
            self._drop_times.popleft()
        return len(self._drop_times)

    def newest_drop(self, topic: str, now: float, max_age: float = _NEWEST_DROP_MEMORY) -> str:
        """Return why the newest message of a topic was dropped; empty if it was accepted, or was dropped long ago.

        Args:
            topic: topic of the message.
            now: [s] steady time.
            max_age: [s] An older drop is not returned.
        """
        dropped, text = self._newest_drops.get(topic, (-math.inf, ""))
        is_newest = dropped > self.last_received.get(topic, -math.inf) and now - dropped <= max_age
        return text if is_newest else ""

    def accept(self, topic: str, now: float) -> None:
        """Count a message accepted at steady time ``now`` [s]."""
        self.accepted[topic] += 1
        self.last_received[topic] = now

    def ages(self, now: float) -> dict[str, str]:
        """Return the age [s] of the newest accepted message of each topic as key-value pairs."""
        return {f"{topic} age [s]": f"{now - last:.2f}" for topic, last in sorted(self.last_received.items())}

    def report(self, period: float) -> dict[str, str]:
        """Return all counters as key-value pairs, with the rates [Hz] over the ``period`` [s] since the last report."""
        values = {}
        for label, counter in (("received", self.accepted), ("sent", self.sent)):
            for topic, count in sorted(counter.items()):
                key = f"{topic} {label}"
                values[key] = str(count)
                if period > 0.0:
                    values[f"{key} [Hz]"] = f"{(count - self._reported[key]) / period:.1f}"
                self._reported[key] = count
        for (topic, kind), count in sorted(self.dropped.items()):
            values[f"{topic} dropped: {kind}"] = str(count)
        values.update({note: str(count) for note, count in sorted(self.counted.items())})
        return values


class Throttle:
    """Log throttle: passes each key at most once per period."""

    def __init__(self, period: float) -> None:
        """Create a throttle with a ``period`` [s]."""
        self._period = period
        self._passed: dict[Hashable, float] = {}

    def is_due(self, key: Hashable, now: float) -> bool:
        """Return True if ``key`` has not passed for a period, and start a new period; ``now`` is in [s]."""
        self._passed = {one: last for one, last in self._passed.items() if now - last < self._period}
        if key in self._passed:
            return False
        self._passed[key] = now
        return True
