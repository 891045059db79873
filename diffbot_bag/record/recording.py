"""What becomes of a received message: written, held until the first /clock, kept for a snapshot, or left out."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable

from diffbot_bag.bag.writer import BagWriter
from diffbot_bag.record.pending_messages import Held, HeldMessages
from diffbot_bag.record.snapshot import SnapshotBuffer

SLICE = 4_000_000
"""[ns] for which the writing of a snapshot keeps the caller, at a time"""
NO_CLOCK, PAUSED = "no /clock yet", "paused"
"""Why a message is not recorded."""


class Recording:
    """Passes messages on to the writer of a bag; its methods raise BagWriteError as the writer does."""

    def __init__(
        self,
        writer: BagWriter,
        *,
        snapshot: SnapshotBuffer | None = None,
        held: HeldMessages | None = None,
        now: Callable[[], int] | None = None,
    ) -> None:
        """Start to record.

        Args:
            writer: of the bag.
            snapshot: keeps the newest messages until :meth:`take_snapshot`; None: all messages are written.
            held: keeps messages until the first simulated time; together with ``now``.
            now: returns the simulated time [ns], 0 before the first one; None: log times are times of reception.
        """
        self._writer = writer
        self._snapshot, self._held, self._now = snapshot, held, now
        self._unwritten_snapshot: deque[Held] = deque()
        self.is_paused = False

    @property
    def is_direct(self) -> bool:
        """Whether :meth:`accept` does nothing at present but BagWriter.write, which may then be called instead."""
        return not (self.is_paused or self._snapshot is not None or self._now is not None)

    @property
    def held(self) -> int:
        """Number of messages that wait for the first simulated time."""
        return len(self._held) if self._held is not None else 0

    @property
    def waits_for_clock(self) -> bool:
        """Whether no simulated time was received yet."""
        return self._now is not None and (self.held > 0 or self._now() == 0)

    @property
    def in_memory(self) -> int:
        """Number of messages from which a snapshot would be made."""
        return len(self._snapshot) if self._snapshot is not None else 0

    def accept(self, channel: int, data: bytes, received: int, published: int, number: int) -> str:
        """Take a message that was received; times in [ns]. Return why it is not recorded, empty if it is.

        Latched messages are recorded during a pause, too: what follows cannot be understood without them.
        """
        if self.is_paused and not self._writer.is_latched(channel):
            return PAUSED
        log_time = received
        if self._now is not None and (log_time := self._now()) == 0:
            held = self._held is not None and self._held.hold(Held(channel, data, received, published, number))
            return "" if held else NO_CLOCK
        if self._held:
            self.release(log_time)
        if self._snapshot is not None:
            self._keep(Held(channel, data, log_time, published, number))
            return ""
        self._writer.write(channel, data, log_time, published, number)
        return ""

    def _keep(self, message: Held) -> None:
        if self._snapshot is not None:
            for gone in self._snapshot.push(message):
                self._writer.remember(gone)

    def release(self, now: int | None) -> None:
        """Record the messages held, with the time ``now`` [ns]; None: with that of their reception."""
        for message in self._held.release() if self._held is not None else ():
            timed = message if now is None else message._replace(received=now)
            if self._snapshot is not None:
                self._keep(timed)
            else:
                self._writer.write(*timed.at(timed.received))

    def tick(self) -> None:
        """Release what was held once there is a simulated time; to be called now and then."""
        if self._held and self._now is not None and (now := self._now()):
            self.release(now)

    def take_snapshot(self) -> tuple[bool, str]:
        """Begin to write all messages in memory to a file of their own; return success and a text.

        :meth:`write_snapshot` goes on.
        """
        if self._snapshot is None:
            return False, "not in snapshot mode (snapshot_mode)"
        if self._unwritten_snapshot:
            return False, "the last snapshot is still being written"
        if not self._snapshot:
            return False, "no message in memory"
        self._unwritten_snapshot.extend(self._snapshot.take())
        return True, f"{len(self._unwritten_snapshot)} messages"

    def write_snapshot(self, duration: int = SLICE) -> None:
        """Go on writing a snapshot, for ``duration`` [ns]; no effect without one."""
        messages = self._unwritten_snapshot
        end = time.monotonic_ns() + duration
        while messages and time.monotonic_ns() < end:
            for _ in range(min(100, len(messages))):
                message = messages.popleft()
                self._writer.write(*message.at(message.received))
            if not messages:
                self._writer.split()

    def finish(self) -> None:
        """Write what is still to be written before the bag is closed."""
        while self._unwritten_snapshot:
            self.write_snapshot()
