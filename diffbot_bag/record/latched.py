"""The messages that a late subscriber of a latched (transient local) topic would get, for the head of each file."""

from __future__ import annotations

from collections.abc import Iterator

from diffbot_bag.record.pending_messages import Held


class LatchedMessages:
    """The last message of each publisher of one topic.

    A message carries its sequence number but not its publisher: one that follows another by number replaces it, if
    there is only one such. Where that is ambiguous, both are kept, the older one first, up to twice the publishers.
    """

    def __init__(self, publishers: int) -> None:
        """Start empty, for a topic with so many publishers."""
        self.publishers = publishers
        self._messages: list[Held] = []

    def __iter__(self) -> Iterator[Held]:
        """Iterate over the messages in the order of reception."""
        return iter(self._messages)

    def keep(self, message: Held) -> None:
        """Take in a message that was just received."""
        if self.publishers <= 1:
            self._messages = [message]
            return
        before = [one for one in self._messages if one.number == message.number - 1 and message.number > 0]
        if len(before) == 1:
            self._messages.remove(before[0])
        self._messages.append(message)
        del self._messages[: -2 * self.publishers]
