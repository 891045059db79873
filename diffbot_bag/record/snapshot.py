"""The most recent messages, kept in memory until a snapshot of them is asked for."""

from __future__ import annotations

from collections import deque

from diffbot_bag.record.pending_messages import Held

OVERHEAD = 250
"""[bytes] that a message takes in memory besides its data: the object, its numbers and its place"""


class SnapshotBuffer:
    """A ring of messages, bounded by bytes and by time."""

    def __init__(self, max_bytes: int, max_duration: int = 0) -> None:
        """Start empty.

        Args:
            max_bytes: [bytes] of memory; a message that is larger than that is not kept.
            max_duration: [ns] between the oldest and the newest log time; 0: no limit.
        """
        self._max_bytes, self._max_duration = max_bytes, max_duration
        self._messages: deque[Held] = deque()
        self.size = 0
        """[bytes] of memory in use"""

    def __len__(self) -> int:
        """Return the number of messages."""
        return len(self._messages)

    def push(self, message: Held) -> list[Held]:
        """Add the newest message; return those that had to leave, oldest first."""
        messages, left = self._messages, []
        messages.append(message)
        self.size += len(message.data) + OVERHEAD
        oldest = message.received - self._max_duration if self._max_duration else 0
        while messages and (self.size > self._max_bytes or messages[0].received < oldest):
            gone = messages.popleft()
            self.size -= len(gone.data) + OVERHEAD
            left.append(gone)
        return left

    def take(self) -> list[Held]:
        """Return all messages, oldest first, and start anew."""
        messages = list(self._messages)
        self._messages.clear()
        self.size = 0
        return messages
