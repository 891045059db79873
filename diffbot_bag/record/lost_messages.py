"""Count lost messages by the sequence numbers of the publishers."""

from __future__ import annotations

import operator
from collections.abc import Sequence


class GapCounter:
    """Lost messages of one topic.

    A message carries its sequence number but not its publisher, so the numbers of several publishers form interleaved
    chains; a message continues the chain whose last number precedes its own. The count is exact for one publisher and
    an estimate for several: a publisher that discovery has not reported yet looks like a gap.
    """

    def __init__(self) -> None:
        """Start with one publisher, of which nothing has been received."""
        self.lost = 0
        self.publishers = 1
        """number of publishers on the topic; a number that would start one more chain is a gap instead"""
        self._last: list[int] = []

    def note(self, number: int) -> int:
        """Record the sequence number of a received message; return how many messages were lost before it."""
        last = self._last
        if number - 1 in last:
            last[last.index(number - 1)] = number
            return 0
        if len(last) < self.publishers:
            last.append(number)
            return 0
        before = [index for index, value in enumerate(last) if value < number]
        if not before:
            # The number is below all chains: a publisher was replaced by a new one, which counts from 1.
            last[last.index(min(last))] = number
            return 0
        nearest = max(before, key=last.__getitem__)
        missing = number - last[nearest] - 1
        last[nearest] = number
        self.lost += missing
        return missing

    def note_all(self, numbers: Sequence[int]) -> None:
        """Record the sequence numbers of messages in the order of reception."""
        if not numbers:
            return
        self.note(numbers[0])
        if self.publishers == 1 and all(map(operator.eq, numbers, range(numbers[0], numbers[0] + len(numbers)))):
            self._last = [numbers[-1]]
            return
        for number in numbers[1:]:
            self.note(number)
