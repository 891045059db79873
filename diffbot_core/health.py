"""Counters of received, dropped and sent messages, for /diagnostics; free of ROS."""

from __future__ import annotations

from collections import Counter


class Health:
    """Counters of one node: messages accepted and sent per topic, drops per topic and reason."""

    def __init__(self) -> None:
        """Start with all counters at zero."""
        self.accepted: Counter[str] = Counter()
        self.sent: Counter[str] = Counter()
        self.dropped: Counter[tuple[str, str]] = Counter()
        self.notes: dict[str, str] = {}
        self.counted: Counter[str] = Counter()
        """further counters, by their key in the report"""
        self.last_received: dict[str, float] = {}
        """[s] steady time of the last accepted message, by topic"""
        self._reported: Counter[str] = Counter()

    def drop(self, topic: str, kind: str) -> bool:
        """Count a dropped message; return True for the first of its topic and kind, which is worth a log entry."""
        self.dropped[topic, kind] += 1
        return self.dropped[topic, kind] == 1

    def accept(self, topic: str, now: float) -> None:
        """Count a message accepted at steady time ``now`` [s]."""
        self.accepted[topic] += 1
        self.last_received[topic] = now

    def ages(self, now: float) -> dict[str, str]:
        """Return the age [s] of the last message of each topic as key-value pairs."""
        return {f"{topic} age [s]": f"{now - last:.2f}" for topic, last in sorted(self.last_received.items())}

    def report(self, period: float) -> dict[str, str]:
        """Return all counters as key-value pairs; rates [Hz] are over the ``period`` [s] since the last report."""
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
        values.update(self.notes)
        return values
