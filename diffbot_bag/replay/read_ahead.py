"""Read messages ahead of their replay, so that decompressing a chunk does not delay a message."""

from __future__ import annotations

import queue
import threading
from collections.abc import Iterable, Iterator
from types import TracebackType

from diffbot_bag.bag.reader import RawMessage

BATCH = 50
"""Messages per queue item: one by one, the queue's locks would cost more than reading."""


class ReadAhead:
    """Iterator over messages that a thread reads in advance; leaving the ``with`` block ends the thread."""

    def __init__(self, messages: Iterable[RawMessage], size: int) -> None:
        """Start to read; at most about ``size`` messages are held."""
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
        # Empty the queue: the reading thread may be blocked on a full one.
        while self._thread.is_alive():
            try:
                self._queue.get_nowait()
            except queue.Empty:
                self._thread.join(0.01)

    def __iter__(self) -> Iterator[RawMessage]:
        """Iterate over the messages; an exception of the reading thread is raised here.

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
        except Exception as error:  # passed on to the consumer, after the messages read before it
            end = error
        self._queue.put(batch)
        self._queue.put(end)
