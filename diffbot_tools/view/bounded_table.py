"""A table with names that come from outside: its memory is bounded, whatever is sent."""

from __future__ import annotations

from typing import TypeVar

K = TypeVar("K")
V = TypeVar("V")


class BoundedTable(dict[K, V]):
    """A dict in the order in which its entries were last set; beyond its size the oldest is dropped and counted."""

    def __init__(self, size: int) -> None:
        """Start empty; ``size`` is the number of entries that are kept."""
        super().__init__()
        self._size = size
        self.dropped = 0

    def __setitem__(self, key: K, value: V) -> None:
        """Set an entry, which becomes the newest."""
        self.pop(key, None)
        super().__setitem__(key, value)
        if len(self) > self._size:
            del self[next(iter(self))]
            self.dropped += 1
