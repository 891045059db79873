"""Run a campaign as chunks of runs in worker processes, on this machine or on a cluster.

The counts of each finished chunk are written to the journal. Counts can be added exactly, so the result does not depend
on the order of the chunks, on the number of workers, or on interruptions.
"""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from multiprocessing import get_context
from typing import Any, NamedTuple

from tqdm import tqdm

from diffbot_control.law.registry import resolve_law
from diffbot_core.errors import DiffbotError
from diffbot_core.installed import install_hint
from diffbot_lab.campaign.journal import Journal
from diffbot_lab.campaign.spec import Campaign, code_version
from diffbot_lab.campaign.statistics import count_outcomes
from diffbot_sim.batch import Starts, run_batch
from diffbot_sim.robot_step import Case

_CONNECT_TIMEOUT = 10.0
"""[s] timeout for the connection to the scheduler of a cluster"""
_RETRIES = 3
"""largest number of consecutive times that a killed worker may break the pool before a chunk is finished"""


class Chunk(NamedTuple):
    """Runs ``first`` to ``first + number - 1`` of one cell, with everything that a worker needs."""

    cell: int
    first: int
    number: int
    case: Case
    starts: Starts
    seed: int
    law: str
    """argument of :func:`resolve_law`"""
    sources: str
    """hash of the code that determines the results"""


def run_chunk(chunk: Chunk) -> dict[str, Any]:
    """Simulate a chunk and return its counts. Workers call this function.

    Raises:
        DiffbotError: if the worker has another version of the code.
    """
    if chunk.sources != code_version():
        raise DiffbotError("a worker has another version of the code: install the same version on all workers")
    runs = chunk.seed, chunk.first, chunk.number
    return count_outcomes(run_batch(chunk.case, chunk.starts, *runs, threads=1, law=resolve_law(chunk.law)))


def open_chunks(campaign: Campaign, done: set[tuple[int, int]]) -> Iterator[Chunk]:
    """Yield the chunks that are not in ``done``, ordered by cell."""
    for number, cell in enumerate(campaign.cells):
        chunks = campaign.chunks(number)
        for first in chunks:
            if (number, first) not in done:
                count = min(chunks.step, campaign.options.runs - first)
                seed, sources = campaign.options.seed, code_version()
                yield Chunk(number, first, count, cell.case, campaign.starts, seed, cell.law, sources)


def run_campaign(campaign: Campaign, journal: Journal, make_executor: Callable[[], Executor], workers: int) -> None:
    """Run the chunks that are missing in the journal.

    Args:
        campaign: the campaign.
        journal: journal of the campaign, to which finished chunks are written.
        make_executor: called at the start, and again after a killed worker broke the pool.
        workers: number of workers. Twice as many chunks are submitted at a time.

    Raises:
        DiffbotError: if workers are killed again and again, a worker fails, or the journal cannot be written.
    """
    total = campaign.options.runs * len(campaign.cells)
    finished = sum(one.runs for one in journal.statistics)
    failures = 0
    with tqdm(total=total, initial=finished, unit="run", desc="campaign", disable=None, smoothing=0.05) as bar:
        while True:
            before = len(journal.done)
            try:
                for chunk, counts in _completed(open_chunks(campaign, journal.done), make_executor, 2 * workers):
                    journal.add(chunk.cell, chunk.first, counts)
                    bar.update(chunk.number)
                return
            except BrokenExecutor:
                failures = 1 if len(journal.done) > before else failures + 1
                if failures > _RETRIES:
                    text = "workers were killed again and again, maybe for lack of memory; finished chunks are kept"
                    raise DiffbotError(text) from None


def _completed(
    chunks: Iterator[Chunk], make_executor: Callable[[], Executor], window: int
) -> Iterator[tuple[Chunk, dict[str, Any]]]:
    """Yield chunks and counts in order of completion. At most ``window`` chunks are submitted at a time."""
    executor = make_executor()
    running: dict[Future[dict[str, Any]], Chunk] = {}
    try:
        for chunk in chunks:
            running[executor.submit(run_chunk, chunk)] = chunk
            if len(running) >= window:
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    yield running.pop(future), _result(future)
        while running:
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                yield running.pop(future), _result(future)
    finally:
        for future in running:
            future.cancel()
        executor.shutdown(wait=True)


def _result(future: Future[dict[str, Any]]) -> dict[str, Any]:
    try:
        return future.result()
    except (BrokenExecutor, DiffbotError):
        raise
    except Exception as error:  # a worker of a cluster can raise anything
        text = " ".join(f"{type(error).__name__} {error}".split())
        raise DiffbotError(f"a worker failed: {text}; finished chunks are kept") from error


def process_pool(workers: int) -> Executor:
    """Return a pool of processes on this machine."""
    return ProcessPoolExecutor(workers, mp_context=get_context("spawn"), initializer=_ignore_interrupt)


def _ignore_interrupt() -> None:
    # Ctrl-C is sent to all processes of a terminal. The workers ignore it, because the campaign shuts them down.
    signal.signal(signal.SIGINT, signal.SIG_IGN)


@contextmanager
def cluster_executor(address: str) -> Iterator[tuple[Callable[[], Executor], int]]:
    """Connect to a dask.distributed cluster; yield a function that makes an executor, and the number of workers.

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
            raise DiffbotError(f"the scheduler at {address} has no workers: start some with `dask worker {address}`")
        yield lambda: client.get_executor(retries=_RETRIES, pure=False), workers
