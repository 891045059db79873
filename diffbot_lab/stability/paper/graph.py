"""Builds the graph of a loop from the images of its cells: in threads, resumable, and written down on Ctrl-C."""

from __future__ import annotations

import json
import os
import time
import zipfile
from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from diffbot_core.errors import DiffbotError
from diffbot_core.files import replacing
from diffbot_lab.stability.code_name import name_of_code
from diffbot_lab.stability.interval.compiled import compile_bounds
from diffbot_lab.stability.paper.images import PaperLoop, images, most_images
from diffbot_lab.stability.rank.cells import Cell, Cells, block_of
from diffbot_lab.stability.rank.ranking import Graph

_CELLS_AT_A_TIME = 8_000
_SAVED_EVERY = 60.0
"""[s]"""

Part = tuple[NDArray[np.int16], NDArray[np.int64]]
"""Blocks of some rows, and how many each cell has."""


def _fill(loop: PaperLoop, rho: Any, alpha: Any, first: int, boxes: Any, blocks: Any, counts: Any) -> int:
    """List the blocks of the cells of some rows, row ``first`` on; return how many there are."""
    columns = len(alpha) - 1
    used = 0
    for index in range(len(counts)):
        row, column = first + index // columns, index % columns
        cell = Cell(rho[row], rho[row + 1], alpha[column], alpha[column + 1])
        before = used
        for at in range(images(loop, cell, boxes)):
            box = boxes[at]
            block = block_of(rho, columns, box[0], box[1], box[2], box[3])
            if used > before:
                last = blocks[used - 1]
                if (
                    last[0] == block.first_row
                    and last[1] == block.last_row
                    and last[2] == block.first_column
                    and last[3] == block.last_column
                ):
                    continue
            blocks[used, 0], blocks[used, 1] = block.first_row, block.last_row
            blocks[used, 2], blocks[used, 3] = block.first_column, block.last_column
            used += 1
        counts[index] = used - before
    return used


_fill_kernel = compile_bounds(_fill)


def _part(loop: PaperLoop, cells: Cells, first: int, last: int) -> Part:
    """Return the blocks of the rows from ``first`` to before ``last``."""
    columns = len(cells.alpha) - 1
    most = most_images(loop, float(cells.rho[first]))
    counts = np.zeros((last - first) * columns, np.int64)
    blocks = np.empty((len(counts) * most, 4), np.int16)
    used = _fill_kernel(loop, cells.rho, cells.alpha, first, np.empty((most, 4)), blocks, counts)
    return blocks[:used].copy(), counts


def build_graph(loop: PaperLoop, cells: Cells, threads: int | None = None, state: Path | None = None) -> Graph:
    """Compute the images of all cells.

    Args:
        loop: law, noise and plant.
        cells: the plane's division.
        threads: how many at a time; None for one on each core.
        state: file in which finished parts are kept, to go on from after an interruption; None for no such file.

    Raises:
        DiffbotError: if the state is of another calculation or is no such file.
        KeyboardInterrupt: after writing the state.
    """
    rows, columns = len(cells.rho) - 1, len(cells.alpha) - 1
    step = max(1, _CELLS_AT_A_TIME // columns)
    tasks = [(first, min(first + step, rows)) for first in range(0, rows, step)]
    name = json.dumps([name_of_code(), loop._asdict(), cells.rho.tolist(), columns])
    parts = _load(state, name)
    try:
        _compute(loop, cells, tasks, parts, threads, lambda: _save(state, name, parts))
    except KeyboardInterrupt:
        _save(state, name, parts)
        raise
    counts = np.concatenate([parts[index][1] for index in range(len(tasks))])
    blocks = np.concatenate([parts[index][0] for index in range(len(tasks))])
    return Graph(blocks, np.concatenate([[0], np.cumsum(counts)]).astype(np.int64), rows, columns)


def _compute(
    loop: PaperLoop,
    cells: Cells,
    tasks: list[tuple[int, int]],
    parts: dict[int, Part],
    threads: int | None,
    save: Callable[[], None],
) -> None:
    """Add the parts that are missing; after an interruption, those that were under way, too."""
    saved = time.monotonic()
    with (
        tqdm(desc="images", total=len(tasks), initial=len(parts), unit="part", disable=None, smoothing=0.05) as bar,
        ThreadPoolExecutor(threads or os.cpu_count() or 1) as pool,
    ):
        running: dict[Future[Part], int] = {}
        for index in range(len(tasks)):
            if index not in parts:
                running[pool.submit(_part, loop, cells, *tasks[index])] = index
        try:
            while running:
                for one in wait(running, return_when=FIRST_COMPLETED).done:
                    parts[running.pop(one)] = one.result()
                    bar.update()
                if time.monotonic() - saved > _SAVED_EVERY:
                    save()
                    saved = time.monotonic()
        except KeyboardInterrupt:
            pool.shutdown(cancel_futures=True)
            finished = {index: one for one, index in running.items() if not one.cancelled() and one.exception() is None}
            parts |= {index: one.result() for index, one in finished.items()}
            raise


def _save(state: Path | None, name: str, parts: dict[int, Part]) -> None:
    if state is None:
        return
    arrays: dict[str, Any] = {"name": np.array(name)}
    for index, (blocks, counts) in parts.items():
        arrays |= {f"blocks_{index}": blocks, f"counts_{index}": counts}
    with replacing(state) as part, part.open("wb") as file:
        np.savez(file, **arrays)


def _load(state: Path | None, name: str) -> dict[int, Part]:
    if state is None or not state.exists():
        return {}
    try:
        with state.open("rb") as file, np.load(file, allow_pickle=False) as saved:
            if str(saved["name"]) != name:
                raise DiffbotError(f"{state} is of another certificate or of other code; delete it to start again")
            numbers = [int(key.removeprefix("blocks_")) for key in saved.files if key.startswith("blocks_")]
            return {index: (saved[f"blocks_{index}"], saved[f"counts_{index}"]) for index in numbers}
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise DiffbotError(f"{state} cannot be read: {error}; delete it to start again") from None
