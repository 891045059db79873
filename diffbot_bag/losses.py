"""Count the lost messages of a topic from the sequence numbers of its publishers."""

from __future__ import annotations

from collections.abc import Callable


class _Sequence:
    """The received sequence numbers of one publisher."""

    def __init__(self, last: int) -> None:
        self.last = last
        self.origin: _Sequence | None = None
        """sequence that this one may continue after a gap; None if it has its own publisher"""
        self.gap = 0
        """messages that are counted as lost between ``origin`` and this sequence"""


class LossCounter:
    """Counter of the lost messages of one topic.

    A message has a sequence number but does not name its publisher. So the numbers of several publishers are
    interleaved, and a number continues the sequence whose last number precedes it. A number that does not continue a
    sequence is either the first number of another publisher, or there is a gap before it. It is counted as a gap until
    the previous sequence continues, which shows that there are two publishers; then the gap is subtracted again.

    The count is exact for one publisher. With several publishers, messages that a publisher loses before its first
    received message are not counted.
    """

    def __init__(self, count_publishers: Callable[[], int]) -> None:
        """Start without messages; ``count_publishers`` returns the current number of publishers."""
        self.lost = 0
        self.publishers = 1
        """largest number of publishers so far, and largest number of sequences that are distinguished"""
        self._count_publishers = count_publishers
        self._sequences: list[_Sequence] = []
        self._next = -1
        """number that continues the only sequence; -1 if there is not exactly one sequence"""

    def note_publishers(self) -> None:
        """Update the number of publishers. Call it regularly: a publisher may leave before its messages are read."""
        self.publishers = max(self.publishers, self._count_publishers())

    def note(self, number: int) -> None:
        """Record the sequence number of a received message."""
        if number == self._next:
            self._next = number + 1
            return
        sequences = self._sequences
        if self._next >= 0:
            sequences[0].last = self._next - 1
        self._continue_or_begin(number)
        self._next = sequences[0].last + 1 if len(sequences) == 1 else -1

    def _continue_or_begin(self, number: int) -> None:
        sequences = self._sequences
        sequence = next((known for known in sequences if known.last == number - 1), None)
        if sequence is None:
            self.note_publishers()
            earlier = [known for known in sequences if known.last < number]
            sequence = max(earlier, key=lambda known: known.last, default=None)
            if sequence is None or len(sequences) < self.publishers:
                self._begin(number, sequence)
                return
            self.lost += number - sequence.last - 1
        sequence.last = number
        for other in sequences:
            if other.origin is sequence:
                self.lost -= other.gap
                other.origin = None

    def _begin(self, number: int, origin: _Sequence | None) -> None:
        """Begin a sequence. If each publisher has one, replace the lowest one, whose publisher has left."""
        if len(self._sequences) >= self.publishers:
            lowest = min(self._sequences, key=lambda known: known.last)
            lowest.last, lowest.origin = number, None
            for other in self._sequences:
                if other.origin is lowest:
                    other.origin = None
            return
        sequence = _Sequence(number)
        if origin is not None:
            sequence.gap, sequence.origin = number - origin.last - 1, origin
            self.lost += sequence.gap
        self._sequences.append(sequence)
