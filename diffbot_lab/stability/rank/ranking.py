"""Ranks of cells: how many steps at most until every trajectory from a cell is in the core.

The graph keeps blocks of cells, not edges: cell c leads to the blocks start[c] .. start[c + 1]. Sets of cells are
arrays (rows, columns) of 0 and 1.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from diffbot_core.errors import DiffbotError
from diffbot_lab.stability.interval.compiled import compile_bounds

UNRANKED = -1
MAX_RANK = 32_000


class Graph(NamedTuple):
    """Where each cell leads in one step."""

    blocks: NDArray[np.int16]
    """(n, 4) rows first, last, columns first, last; see :class:`diffbot_lab.stability.rank.cells.Block`"""
    start: NDArray[np.int64]
    """(cells + 1,) first block of each cell, row by row"""
    rows: int
    columns: int


class Ranking(NamedTuple):
    """The result."""

    ranks: NDArray[np.int16]
    """(rows, columns) 0 in the core, UNRANKED where a trajectory may leave the cells"""
    recurrent: NDArray[np.uint8]
    """(rows, columns) a superset of the cells to which a trajectory that never comes inside may return for ever"""


def _fill_table(cells: Any, table: Any) -> None:
    """Sum up: table[i, j] is the number of cells in rows below i and columns below j, columns twice around."""
    rows, columns = cells.shape
    for i in range(rows):
        total = 0
        for j in range(2 * columns):
            total += cells[i, j - columns if j >= columns else j]
            table[i + 1, j + 1] = table[i, j + 1] + total


def _meets(block: Any, table: Any, rows: int, beyond: int) -> bool:
    """Return True if a block meets the cells that were summed up; ``beyond`` tells if what is beyond them counts."""
    last = block[1]
    if last >= rows:
        if beyond:
            return True
        last = rows - 1
    if last < block[0]:
        return False
    above, below = last + 1, block[0]
    right, left = block[3] + 1, block[2]
    return bool(table[above, right] - table[below, right] - table[above, left] + table[below, left] > 0)


def _sweep(graph: Graph, alive: Any, beyond: int, table: Any, active: Any, witness: Any) -> int:
    """Remove the cells whose blocks meet no cell that was alive before; return how many are left of ``active``."""
    _fill_table(alive, table)
    left = 0
    flat = alive.ravel()
    for index in range(len(active)):
        cell = active[index]
        found = witness[cell] >= 0 and _meets(graph.blocks[witness[cell]], table, graph.rows, beyond)
        if not found:
            for at in range(graph.start[cell], graph.start[cell + 1]):
                if _meets(graph.blocks[at], table, graph.rows, beyond):
                    witness[cell] = at
                    found = True
                    break
        if found:
            active[left] = cell
            left += 1
        else:
            flat[cell] = 0
    return left


def _count_covers(graph: Graph, active: Any, counts: Any) -> None:
    """Count in (rows + 1, 2 columns + 1) from how many blocks of ``active`` cells each cell can be reached."""
    counts[:] = 0
    for cell in active:
        for at in range(graph.start[cell], graph.start[cell + 1]):
            first, last, left, right = graph.blocks[at]
            last = min(last, graph.rows - 1)
            if last >= first:
                counts[first, left] += 1
                counts[last + 1, left] -= 1
                counts[first, right + 1] -= 1
                counts[last + 1, right + 1] += 1
    for i in range(counts.shape[0]):
        for j in range(1, counts.shape[1]):
            counts[i, j] += counts[i, j - 1]
    for i in range(1, counts.shape[0]):
        for j in range(counts.shape[1]):
            counts[i, j] += counts[i - 1, j]


_sweep_kernel = compile_bounds(_sweep)
_count_kernel = compile_bounds(_count_covers)


def _active(cells: NDArray[np.uint8]) -> NDArray[np.int64]:
    return np.flatnonzero(cells).astype(np.int64)


def reached(graph: Graph, cells: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Return the cells that the given ones lead to."""
    rows, columns = graph.rows, graph.columns
    counts = np.zeros((rows + 1, 2 * columns + 1), np.int32)
    _count_kernel(graph, _active(cells), counts)
    once, again = counts[:rows, :columns] > 0, counts[:rows, columns : 2 * columns] > 0
    return np.asarray(once | again)


def remove_transient(
    graph: Graph, alive: NDArray[np.uint8], beyond: bool, each: Callable[[NDArray[np.uint8]], None]
) -> None:
    """Remove, sweep by sweep, the cells that lead only to removed ones, until none is; ``each`` is called after each.

    Args:
        graph: of the loop.
        alive: changed in place.
        beyond: what lies beyond the cells counts as alive.
        each: gets ``alive``.
    """
    table = np.zeros((graph.rows + 1, 2 * graph.columns + 1), np.int32)
    witness = np.full(graph.rows * graph.columns, -1, np.int64)
    active = _active(alive)
    while True:
        left = _sweep_kernel(graph, alive, int(beyond), table, active, witness)
        if left == len(active):
            return
        active = active[:left]
        each(alive)


def recurrent_cells(graph: Graph, each: Callable[[NDArray[np.uint8]], None]) -> NDArray[np.uint8]:
    """Return a superset of the cells on cycles: those left with a successor and a predecessor among themselves."""
    alive = np.ones((graph.rows, graph.columns), np.uint8)
    while True:
        before = int(alive.sum())
        remove_transient(graph, alive, False, each)
        alive &= reached(graph, alive)
        if int(alive.sum()) == before:
            return alive


def rank_cells(graph: Graph, inside_rows: int, each: Callable[[NDArray[np.uint8]], None]) -> Ranking:
    """Compute the core and the ranks.

    The core is everything that can be reached from the recurrent cells and from the first ``inside_rows`` rows, those
    that a step from inside may lead to. A cell of rank n > 0 leads only to smaller ranks.

    Raises:
        DiffbotError: if the core reaches beyond the cells, so that there is no certificate.
    """
    recurrent = recurrent_cells(graph, each)
    core = recurrent.copy()
    core[:inside_rows] = 1
    while True:
        fresh = reached(graph, core) & (core == 0)
        if not fresh.any():
            break
        core[fresh] = 1
    if core[-1].any():
        raise DiffbotError("no certificate: the recurrent cells reach as far as the cells do; take smaller cells")
    ranks = np.where(core > 0, 0, UNRANKED).astype(np.int16)
    alive = (core == 0).astype(np.uint8)
    number = 0

    def rank_removed(now: NDArray[np.uint8]) -> None:
        nonlocal number
        number += 1
        if number > MAX_RANK:
            raise DiffbotError(f"no certificate: ranks beyond {MAX_RANK}; take smaller cells")
        ranks[(now == 0) & (ranks == UNRANKED)] = number
        each(now)

    remove_transient(graph, alive, True, rank_removed)
    return Ranking(ranks, recurrent)
