"""Count lost messages of one topic by the sequence numbers of its publishers."""

from __future__ import annotations

from collections.abc import Callable


class _Chain:
    """The consecutive numbers of one publisher."""

    def __init__(self, last: int) -> None:
        self.last = last
        self.gap = 0
        """messages counted as lost before this chain, as long as it may be the continuation of ``origin``"""
        self.origin: _Chain | None = None


class LossCounter:
    """Lost messages of one topic.

    A message carries its sequence number but not its publisher, so the numbers of several publishers form interleaved
    chains; a message continues the chain whose last number precedes its own. A number that continues no chain is
    either the first one of another publisher or comes after a gap. It counts as a gap until the chain before it goes on
    by itself: then there are two publishers, and the gap is withdrawn. So a publisher that never sends hides no gap.

    The count is exact for one publisher. For several, it misses what a publisher loses before its first message.
    """

    def __init__(self, count_publishers: Callable[[], int]) -> None:
        """Start without a message; ``count_publishers`` returns the number of publishers at present."""
        self.lost = 0
        self.publishers = 1
        """largest number of publishers so far; no more chains are distinguished"""
        self._count_publishers = count_publishers
        self._chains: list[_Chain] = []
        self._next = -1
        """number that continues the only chain; -1 if there is not exactly one"""

    def note_publishers(self) -> None:
        """Look at the number of publishers, regularly: a publisher may leave before its last messages are noted."""
        self.publishers = max(self.publishers, self._count_publishers())

    def note(self, number: int) -> None:
        """Record the sequence number of a received message."""
        if number == self._next:
            self._next = number + 1
            return
        chains = self._chains
        if self._next >= 0:
            chains[0].last = self._next - 1
        self._note(number)
        self._next = chains[0].last + 1 if len(chains) == 1 else -1

    def _note(self, number: int) -> None:
        chains = self._chains
        chain = next((one for one in chains if one.last == number - 1), None)
        if chain is None:
            self.note_publishers()
            before = [one for one in chains if one.last < number]
            chain = max(before, key=lambda one: one.last, default=None)
            if chain is None or len(chains) < self.publishers:
                self._begin(number, chain)
                return
            self.lost += number - chain.last - 1
        chain.last = number
        for other in chains:
            if other.origin is chain:
                self.lost -= other.gap
                other.origin = None

    def _begin(self, number: int, origin: _Chain | None) -> None:
        """Begin a chain; without room for it, it replaces the one with the lowest number, whose publisher is gone."""
        if len(self._chains) >= self.publishers:
            lowest = min(self._chains, key=lambda one: one.last)
            lowest.last, lowest.origin = number, None
            for other in self._chains:
                if other.origin is lowest:
                    other.origin = None
            return
        chain = _Chain(number)
        if origin is not None:
            chain.gap, chain.origin = number - origin.last - 1, origin
            self.lost += chain.gap
        self._chains.append(chain)
