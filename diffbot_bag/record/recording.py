"""What becomes of a received message: it is written, held until the first /clock, or left out."""

from __future__ import annotations

from collections.abc import Callable

from diffbot_bag.bag.writer import BagWriter
from diffbot_bag.record.pending_messages import Held, HeldMessages

NO_CLOCK, PAUSED = "no /clock yet", "paused"
"""Why a message is not recorded."""


class Recording:
    """Passes messages on to the writer of a bag; its methods raise BagWriteError as the writer does."""

    def __init__(
        self,
        writer: BagWriter,
        *,
        held: HeldMessages | None = None,
        now: Callable[[], int] | None = None,
    ) -> None:
        """Start to record.

        Args:
            writer: of the bag.
            held: keeps messages until the first simulated time; together with ``now``.
            now: returns the simulated time [ns], 0 before the first one; None: log times are times of reception.
        """
        self._writer, self._held, self._now = writer, held, now
        self.is_paused = False

    @property
    def is_direct(self) -> bool:
        """True if :meth:`accept` only calls BagWriter.write at present; the caller may then do that itself."""
        return not self.is_paused and self._now is None

    @property
    def held(self) -> int:
        """Number of messages that wait for the first simulated time."""
        return len(self._held) if self._held is not None else 0

    @property
    def waits_for_clock(self) -> bool:
        """True until the first message on /clock, and while messages are held for it."""
        return self._now is not None and (self.held > 0 or self._now() == 0)

    def accept(self, channel: int, data: bytes, received: int, published: int, number: int) -> str:
        """Record a received message, with times in [ns]. Return why it is not recorded, or an empty text if it is.

        Latched messages are recorded during a pause, too, since later messages cannot be understood without them.
        """
        if self.is_paused and not self._writer.is_latched(channel):
            return PAUSED
        log_time = received
        if self._now is not None and (log_time := self._now()) == 0:
            held = self._held is not None and self._held.hold(Held(channel, data, received, published, number))
            return "" if held else NO_CLOCK
        if self._held:
            self.release(log_time)
        self._writer.write(channel, data, log_time, published, number)
        return ""

    def release(self, now: int | None) -> None:
        """Record the messages held, with the time ``now`` [ns]; None: with that of their reception."""
        for message in self._held.release() if self._held is not None else ():
            timed = message if now is None else message._replace(received=now)
            self._writer.write(*timed.at(timed.received))

    def tick(self) -> None:
        """Record the held messages once there is a simulated time. Call this regularly."""
        if self._held and self._now is not None and (now := self._now()):
            self.release(now)
