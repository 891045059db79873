"""Where the slow part of writing runs: within the call, or on a thread, so that messages are received meanwhile."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable


class Disk:
    """Runs each job at once."""

    backlog = 0
    """[bytes] handed over and not yet written"""

    def run(self, job: Callable[[], None], size: int = 0) -> None:
        """Run a job that writes ``size`` bytes; jobs run in the order of the calls.

        Raises:
            OSError: what this job, or an earlier one, raised.
        """
        job()

    def wait(self) -> None:
        """Return when all jobs have run; raises as :meth:`run`."""

    def close(self) -> None:
        """Run no more jobs."""


class DiskThread(Disk):
    """Runs the jobs on a thread of its own; after the first error none of them.

    Compression, writing and fsync release Python's interpreter lock.
    """

    def __init__(self) -> None:
        """Start the thread."""
        self._jobs: queue.SimpleQueue[tuple[Callable[[], None], int] | threading.Event | None] = queue.SimpleQueue()
        self._error: BaseException | None = None
        self._given = self._done = 0
        self._thread = threading.Thread(target=self._work, name="disk", daemon=True)
        self._thread.start()

    @property
    def backlog(self) -> int:  # type: ignore[override]
        """Bytes handed over and not yet written."""
        # Each number is changed by one thread only.
        return self._given - self._done

    def run(self, job: Callable[[], None], size: int = 0) -> None:
        """Hand a job over; the error of an earlier one is raised here."""
        if self._error is not None:
            raise self._error
        self._given += size
        self._jobs.put((job, size))

    def wait(self) -> None:
        """Return when all jobs have run."""
        reached = threading.Event()
        self._jobs.put(reached)
        reached.wait()
        if self._error is not None:
            raise self._error

    def close(self) -> None:
        """End the thread after the jobs handed over; nothing may be run or waited for afterwards."""
        self._jobs.put(None)
        self._thread.join()

    def _work(self) -> None:
        while (item := self._jobs.get()) is not None:
            if isinstance(item, threading.Event):
                item.set()
                continue
            job, size = item
            # After an error the file has a gap: nothing may follow.
            if self._error is None:
                try:
                    job()
                except BaseException as error:  # raised again by the next call of run or wait
                    self._error = error
            self._done += size
