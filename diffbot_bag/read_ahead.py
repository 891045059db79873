"""Read a bag ahead of its replay, so that unpacking a chunk never makes a message late."""

from __future__ import annotations

import queue
import threading
from collections.abc import Iterable, Iterator
from types import TracebackType

from diffbot_bag.reader import RawMessage

BATCH = 50
"""Messages handed over at a time: one by one, the queue's locks would cost more than the reading."""


class ReadAhead:
    """Iterator over messages that another thread reads; use it in a ``with`` statement, which ends the thread."""

    def __init__(self, messages: Iterable[RawMessage], size: int) -> None:
        """Begin to read; about ``size`` messages are kept ready."""
        self._batch = max(1, min(BATCH, size))
        self._queue: queue.Queue[list[RawMessage] | Exception | None] = queue.Queue(max(1, size // self._batch))
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._read, args=(messages,), name="read ahead", daemon=True)
        self._thread.start()

    def __enter__(self) -> ReadAhead:
        """Return the iterator itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """End the reading thread."""
        self._stop.set()
        # A reader that waits for room wakes up when there is some.
        while self._thread.is_alive():
            try:
                self._queue.get_nowait()
            except queue.Empty:
                self._thread.join(0.01)

    def __iter__(self) -> Iterator[RawMessage]:
        """Iterate over the messages; what the reading raised is raised here.

        Raises:
            DiffbotError: if the bag is damaged.
        """
        while True:
            item = self._queue.get()
            if item is None:
                return
            if isinstance(item, Exception):
                raise item
            yield from item

    def _read(self, messages: Iterable[RawMessage]) -> None:
        end: Exception | None = None
        batch: list[RawMessage] = []
        try:
            for message in messages:
                batch.append(message)
                if len(batch) >= self._batch:
                    self._queue.put(batch)
                    batch = []
                if self._stop.is_set():
                    return
        except Exception as error:  # it belongs to the thread that plays, after what was read before
            end = error
        self._queue.put(batch)
        self._queue.put(end)
