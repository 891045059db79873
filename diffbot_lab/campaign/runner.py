"""Running a campaign: chunks of runs in worker processes, here or on a cluster.

Each finished chunk goes to the journal as counts. Counts add up exactly, so the result does not depend on the order of
the chunks, on the number of workers or on interruptions.
"""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from multiprocessing import get_context
from typing import Any, NamedTuple

from tqdm import tqdm

from diffbot_control.goals.registry import resolve_law
from diffbot_core.errors import DiffbotError
from diffbot_core.installed import install_hint
from diffbot_lab.campaign.journal import Journal
from diffbot_lab.campaign.spec import Campaign, code_version
from diffbot_lab.campaign.statistics import count_outcomes
from diffbot_sim.batch import Starts, run_batch
from diffbot_sim.robot_step import Case

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
    """Run a chunk in a worker; return its counts.

    Raises:
        DiffbotError: on a worker that has another version of the code.
    """
    if chunk.sources != code_version():
        raise DiffbotError("a worker has another version of the code")
    runs = chunk.seed, chunk.first, chunk.number
    return count_outcomes(run_batch(chunk.case, chunk.starts, *runs, threads=1, law=resolve_law(chunk.law)))


def open_chunks(campaign: Campaign, done: set[tuple[int, int]]) -> Iterator[Chunk]:
    """Yield the chunks that are not in ``done``, cell by cell."""
    for number, cell in enumerate(campaign.cells):
        chunks = campaign.chunks(number)
        for first in chunks:
            if (number, first) not in done:
                count = min(chunks.step, campaign.options.runs - first)
                seed, sources = campaign.options.seed, code_version()
                yield Chunk(number, first, count, cell.case, campaign.starts, seed, cell.law, sources)


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
                    raise DiffbotError("the workers keep dying (out of memory?); finished chunks are kept") from None


def _completed(
    chunks: Iterator[Chunk], make_executor: Callable[[], Executor], window: int
) -> Iterator[tuple[Chunk, dict[str, Any]]]:
    """Yield chunks and counts in order of completion; at most ``window`` are submitted at a time, to bound memory."""
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
    """Give an executor on a dask.distributed cluster and its number of workers; leave the cluster afterwards.

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
