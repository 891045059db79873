"""Running a campaign: chunks of runs through ``Executor.submit``, and a journal that survives interruptions.

The journal (``campaign.jsonl``) holds a line of counts for each finished chunk; an interrupted campaign resumes from
it. Counts add up exactly, so the result does not depend on chunks, order, workers or interruptions.
"""

from __future__ import annotations

import bisect
import fcntl
import os
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

from tqdm import tqdm

from diffbot_control.goals.registry import resolve_law
from diffbot_core.distribution import install_hint
from diffbot_core.errors import DiffbotError
from diffbot_lab.campaign.journal_lines import MAX_LINE, check_chunk, parsed, sealed
from diffbot_lab.campaign.spec import Campaign, code_version
from diffbot_lab.campaign.statistics import CellStatistics, count_outcomes
from diffbot_sim.compiled.batch import Starts, run_batch
from diffbot_sim.compiled.closed_loop import Case

FORMAT = 2
JOURNAL = "campaign.jsonl"
_STEPS_PER_CHUNK = 2_000_000
"""About half a second of one core: frequent enough for the progress bar, and little is lost in a crash."""
_RUNS_PER_CHUNK = 100_000
"""A worker holds the outcomes of all runs of a chunk in memory."""
_CONNECT_TIMEOUT = 10.0
"""[s] to reach the scheduler of a cluster"""
_RETRIES = 3
"""Times in a row that a pool is restarted after a killed worker without any chunk finished in between."""


class Chunk(NamedTuple):
    """Runs ``first`` to ``first + number - 1`` of one cell; all that a worker needs to run them."""

    cell: int
    first: int
    number: int
    case: Case
    starts: Starts
    seed: int
    law: str
    """as for resolve_law"""
    sources: str
    """hash of the code that the campaign runs"""


def run_chunk(chunk: Chunk) -> dict[str, Any]:
    """Run a chunk in a worker; return its line of the journal.

    Raises:
        DiffbotError: on a worker that has another version of the code.
    """
    if chunk.sources != code_version():
        raise DiffbotError("a worker has another version of the code")
    outcomes = run_batch(
        chunk.case, chunk.starts, chunk.seed, chunk.first, chunk.number, threads=1, law=resolve_law(chunk.law)
    )
    return {"cell": chunk.cell, "first": chunk.first, "count": chunk.number, **count_outcomes(outcomes)}


class Journal:
    """The finished chunks of one campaign, a line each, after a header line that names the campaign and the code."""

    def __init__(self, path: Path, campaign: Campaign) -> None:
        """Open or begin the journal.

        Raises:
            DiffbotError: if it belongs to another campaign or another version of the code, is not a journal, or cannot
                be written; it is left as it is.
        """
        self._path = path
        self._runs = campaign.options.runs
        self.statistics = [CellStatistics() for _ in campaign.cells]
        self.done: list[dict[int, int]] = [{} for _ in campaign.cells]
        """for each cell the finished chunks, first run -> number of runs"""
        self._starts: list[list[int]] = [[] for _ in campaign.cells]
        header = {
            "format": FORMAT,
            "identity": campaign.identity,
            "sources": code_version(),
            "cases": campaign.resolved,
            "campaign": campaign.description,
        }
        if path.exists() and not path.is_file() and not path.is_dir():
            raise DiffbotError(f"{path} is not a regular file")
        try:
            # Unbuffered: a failed write would otherwise fail again on closing.
            self._file = path.open("ab", buffering=0)
            try:
                self._begin(header)
            except BaseException:
                self._file.close()
                raise
        except OSError as error:
            raise DiffbotError(f"cannot write {path}: {error.strerror}") from None

    def _begin(self, header: dict[str, Any]) -> None:
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise DiffbotError(f"{self._path} is in use by another process") from None
        except OSError:
            pass  # a file system without locks
        kept = self._load(header)
        self._file.truncate(kept)
        if kept == 0:
            self._append(header)

    def _load(self, header: dict[str, Any]) -> int:
        """Count the lines; return the length of all complete ones: the last line may be cut off."""
        kept = 0
        with self._path.open("rb") as file:
            for number, line in enumerate(iter(lambda: file.readline(MAX_LINE), b""), 1):
                whole = line.endswith(b"\n") or len(line) == MAX_LINE
                if number == 1:
                    self._check_header(parsed(line) if whole else None, header)
                elif whole:
                    try:
                        self._take(parsed(line))
                    except ValueError:
                        raise DiffbotError(f"{self._path}: line {number} is damaged: not touched") from None
                else:
                    break
                kept += len(line)
        return kept

    def _check_header(self, found: Any, expected: dict[str, Any]) -> None:
        if not isinstance(found, dict) or found.get("format") != FORMAT:
            raise DiffbotError(f"{self._path} is no journal of a campaign (format {FORMAT}): not touched")
        if found.get("identity") != expected["identity"]:
            raise DiffbotError(f"{self._path} belongs to another campaign: not touched; choose another --out")
        if found.get("sources") != expected["sources"]:
            raise DiffbotError(f"{self._path} was begun with another version of the code: choose another --out")
        if found.get("cases") != expected["cases"]:
            raise DiffbotError(f"{self._path} was begun with other values of its parameters: choose another --out")

    def _take(self, entry: Any) -> None:
        self._check(entry)
        self._count(entry)

    def _check(self, entry: Any) -> None:
        """Raise ValueError if this is no chunk of the campaign, or if one of its runs is counted already."""
        check_chunk(entry, len(self.done), self._runs)
        first, starts = entry["first"], self._starts[entry["cell"]]
        place = bisect.bisect(starts, first)
        before = starts[place - 1] + self.done[entry["cell"]][starts[place - 1]] if place else 0
        after = starts[place] if place < len(starts) else self._runs
        if not before <= first <= first + entry["count"] <= after:
            raise ValueError("runs that are counted already")

    def _count(self, entry: dict[str, Any]) -> None:
        self.statistics[entry["cell"]].add(entry)
        self.done[entry["cell"]][entry["first"]] = entry["count"]
        bisect.insort(self._starts[entry["cell"]], entry["first"])

    def add(self, entry: dict[str, Any]) -> None:
        """Write and count a finished chunk.

        Raises:
            DiffbotError: if the counts of the worker cannot be right, or the journal cannot be written.
        """
        try:
            self._check(entry)
        except ValueError as error:
            raise DiffbotError(f"a worker returned {error}; finished chunks are kept") from None
        self._append(entry)
        self._count(entry)

    def _append(self, entry: dict[str, Any]) -> None:
        line = memoryview(sealed(entry))
        try:
            while line:
                line = line[self._file.write(line) :]
        except OSError as error:
            raise DiffbotError(f"cannot write {self._path}: {error.strerror}") from None

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def open_chunks(campaign: Campaign, done: list[dict[int, int]]) -> Iterator[Chunk]:
    """Yield chunks for all runs that are not in ``done``, cell by cell."""
    for number, cell in enumerate(campaign.cells):
        size = campaign.options.chunk or min(max(1, _STEPS_PER_CHUNK // cell.case.steps), _RUNS_PER_CHUNK)
        first = 0
        while first < campaign.options.runs:
            if first in done[number]:
                first += done[number][first]
                continue
            later = [begin for begin in done[number] if begin > first]
            end = min(first + size, campaign.options.runs, *later)
            options = campaign.options
            runs = first, end - first
            yield Chunk(number, *runs, cell.case, campaign.starts, options.seed, options.law, code_version())
            first = end


def run_campaign(campaign: Campaign, journal: Journal, make_executor: Callable[[], Executor], workers: int) -> None:
    """Run what is missing in the journal.

    Args:
        campaign: what to run.
        journal: where finished chunks go.
        make_executor: called at the start, and again if a killed worker broke the pool.
        workers: how many chunks run at a time; twice as many are submitted.

    Raises:
        DiffbotError: if the workers keep dying, or a chunk cannot be written.
    """
    total = campaign.options.runs * len(campaign.cells)
    finished = sum(sum(done.values()) for done in journal.done)
    failures = 0
    with tqdm(total=total, initial=finished, unit="run", desc="campaign", disable=None, smoothing=0.05) as bar:
        while True:
            before = finished
            try:
                for entry in _completed(open_chunks(campaign, journal.done), make_executor, 2 * workers):
                    journal.add(entry)
                    finished += entry["count"]
                    bar.update(entry["count"])
                return
            except BrokenExecutor:
                failures = 1 if finished > before else failures + 1
                if failures > _RETRIES:
                    raise DiffbotError("the workers keep dying (out of memory?); finished chunks are kept") from None


def _completed(chunks: Iterator[Chunk], make_executor: Callable[[], Executor], window: int) -> Iterator[dict[str, Any]]:
    """Yield results in order of completion; at most ``window`` chunks are submitted at a time, to bound memory."""
    executor = make_executor()
    running: set[Future[dict[str, Any]]] = set()
    try:
        for chunk in chunks:
            running.add(executor.submit(run_chunk, chunk))
            if len(running) >= window:
                finished, running = wait(running, return_when=FIRST_COMPLETED)
                yield from map(_result, finished)
        while running:
            finished, running = wait(running, return_when=FIRST_COMPLETED)
            yield from map(_result, finished)
    finally:
        for future in running:
            future.cancel()
        executor.shutdown(wait=True)


def _result(future: Future[dict[str, Any]]) -> dict[str, Any]:
    try:
        return future.result()
    except (BrokenExecutor, DiffbotError):
        raise
    except Exception as error:  # of any kind: it comes from another machine
        text = " ".join(f"{type(error).__name__} {error}".split())
        raise DiffbotError(f"a worker failed: {text}; finished chunks are kept") from error


def process_pool(workers: int) -> Executor:
    """Return a pool of processes on this machine."""
    return ProcessPoolExecutor(workers, mp_context=get_context("spawn"), initializer=_ignore_interrupt)


def _ignore_interrupt() -> None:
    # Ctrl-C reaches all processes of the terminal; the campaign itself ends the workers.
    signal.signal(signal.SIGINT, signal.SIG_IGN)


@contextmanager
def cluster_executor(address: str) -> Iterator[tuple[Callable[[], Executor], int]]:
    """Give an executor on a dask.distributed cluster, and how many workers it has; afterwards leave the cluster.

    Raises:
        DiffbotError: if distributed is not installed or no scheduler answers.
    """
    try:
        from distributed import Client  # noqa: PLC0415 - an extra
    except ImportError:
        raise DiffbotError(f"--scheduler needs dask.distributed: {install_hint('cluster')}") from None
    try:
        client = Client(address, timeout=_CONNECT_TIMEOUT, set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        raise DiffbotError(f"no scheduler at {address}: {' '.join(str(error).split())}") from None
    with client:
        workers = sum(client.nthreads().values())
        if workers == 0:
            raise DiffbotError(f"the scheduler at {address} has no workers")
        yield lambda: client.get_executor(retries=_RETRIES, pure=False), workers


def campaign_workers(requested: int | None) -> int:
    """Return how many processes to use: ``requested``, or one for each core that this process may use."""
    return requested or len(os.sched_getaffinity(0))
