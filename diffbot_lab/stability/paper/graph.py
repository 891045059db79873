"""Builds the graph of a loop from the images of its cells: in threads."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from diffbot_lab.stability.interval.compiled import compile_bounds
from diffbot_lab.stability.paper.images import PaperLoop, images, most_images
from diffbot_lab.stability.rank.cells import Cell, Cells, block_of
from diffbot_lab.stability.rank.ranking import Graph

_CELLS_AT_A_TIME = 8_000

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


def build_graph(loop: PaperLoop, cells: Cells, threads: int | None = None) -> Graph:
    """Compute the images of all cells.

    Args:
        loop: law, noise and plant.
        cells: the plane's division.
        threads: how many at a time; None for one on each core.
    """
    rows, columns = len(cells.rho) - 1, len(cells.alpha) - 1
    step = max(1, _CELLS_AT_A_TIME // columns)
    tasks = [(first, min(first + step, rows)) for first in range(0, rows, step)]
    with (
        tqdm(desc="images", total=len(tasks), unit="part", disable=None, smoothing=0.05) as bar,
        ThreadPoolExecutor(threads) as pool,
    ):
        parts = []
        try:
            for part in pool.map(lambda task: _part(loop, cells, *task), tasks):
                parts.append(part)
                bar.update()
        except KeyboardInterrupt:
            pool.shutdown(cancel_futures=True)
            raise
    counts = np.concatenate([part[1] for part in parts])
    blocks = np.concatenate([part[0] for part in parts])
    return Graph(blocks, np.concatenate([[0], np.cumsum(counts)]).astype(np.int64), rows, columns)
