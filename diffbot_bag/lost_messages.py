"""Count lost messages from the sequence numbers that each publisher gives its messages."""

from __future__ import annotations


class GapCounter:
    """Lost messages of one topic.

    A message tells its number but not its publisher, so with several publishers the numbers form several chains: a
    message continues the chain whose last number precedes its own. Exact for one publisher; with more it is an
    estimate, since a new publisher looks like a gap when the graph has not told of it yet.
    """

    def __init__(self) -> None:
        """Begin without a publisher."""
        self.lost = 0
        self.publishers = 1
        """Publishers known on the topic; chains beyond this number are gaps."""
        self._last: list[int] = []

    def note(self, number: int) -> int:
        """Take the number of the next message received; return how many were lost before it."""
        last = self._last
        if number - 1 in last:
            last[last.index(number - 1)] = number
            return 0
        if len(last) < self.publishers:
            last.append(number)
            return 0
        before = [index for index, value in enumerate(last) if value < number]
        if not before:
            # Numbers begin anew: a publisher was replaced by another.
            last[last.index(min(last))] = number
            return 0
        nearest = max(before, key=last.__getitem__)
        missing = number - last[nearest] - 1
        last[nearest] = number
        self.lost += missing
        return missing
