"""Counting what a node took in, dropped and sent, for /diagnostics; free of ROS."""

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
        """what else a node counts, by its words for it"""
        self.heard: dict[str, float] = {}
        """[s] steady time of the last message accepted, per topic"""
        self._reported: Counter[str] = Counter()

    def drop(self, topic: str, kind: str) -> bool:
        """Count a drop; True if it is the first of its topic and kind, i.e. worth a line in the log."""
        self.dropped[topic, kind] += 1
        return self.dropped[topic, kind] == 1

    def accept(self, topic: str, now: float) -> None:
        """Count a message taken at the steady time ``now`` [s]."""
        self.accepted[topic] += 1
        self.heard[topic] = now

    def ages(self, now: float) -> dict[str, str]:
        """Return the time since the last message of each topic, for a diagnostic status."""
        return {f"{topic} age [s]": f"{now - heard:.2f}" for topic, heard in sorted(self.heard.items())}

    def report(self, period: float) -> dict[str, str]:
        """Return key-value pairs for a diagnostic status; rates [Hz] are over ``period`` [s] since the last report."""
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
