"""Messages on their way into a bag, and those that wait for the first simulated time."""

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
    """Messages that came before the first /clock, in order, at most ``limit``.

    Stamping them 0 would put them half a century before the others.
    """

    def __init__(self, limit: int) -> None:
        """Hold at most ``limit`` messages."""
        self._limit = limit
        self._messages: list[Held] = []

    def __len__(self) -> int:
        """Messages held."""
        return len(self._messages)

    def hold(self, message: Held) -> bool:
        """Keep a message; False if there is no room for it."""
        if len(self._messages) >= self._limit:
            return False
        self._messages.append(message)
        return True

    def release(self) -> list[Held]:
        """Return the messages held, in order, and hold none any more."""
        messages, self._messages = self._messages, []
        return messages
