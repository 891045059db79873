"""Received messages that wait for the first simulated time before they are written."""

from __future__ import annotations

from typing import NamedTuple


class Held(NamedTuple):
    """A received message; times in [ns]."""

    channel: int
    data: bytes
    received: int
    published: int
    number: int

    def at(self, log_time: int) -> tuple[int, bytes, int, int, int]:
        """Return the arguments of BagWriter.write for this log time."""
        return self.channel, self.data, log_time, self.published, self.number


class HeldMessages:
    """Messages received before the first /clock, in order, at most ``limit``.

    Writing them at once with time 0 would stretch the bag by decades.
    """

    def __init__(self, limit: int) -> None:
        """Start empty, with room for ``limit`` messages."""
        self._limit = limit
        self._messages: list[Held] = []

    def __len__(self) -> int:
        """Return the number of messages held."""
        return len(self._messages)

    def hold(self, message: Held) -> bool:
        """Add a message; return False if there is no room for it."""
        if len(self._messages) >= self._limit:
            return False
        self._messages.append(message)
        return True

    def release(self) -> list[Held]:
        """Return the messages held, in order, and remove them."""
        messages, self._messages = self._messages, []
        return messages
