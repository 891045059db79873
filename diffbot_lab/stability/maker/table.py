"""Ranks of the cells of (rho, alpha_d, beta_d): rows of rho, each with columns of alpha and of beta of its own.

Near the goal little progress is made in a step and the cells have to be small; far away they would be too many. The
loop is symmetric under a change of the signs of alpha and beta, so only alpha >= 0 is kept. A rank is 0 in the core,
n > 0 for a cell all of whose images are in cells of smaller rank, and UNRANKED as long as that is not shown.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from diffbot_lab.stability.compiled import compile_bounds
from diffbot_lab.stability.maker.images import Cell3, images
from diffbot_lab.stability.maker.law import TunedLoop

CORE, UNRANKED, MAX_RANK = 0, -1, 32_000
PADDING = 2e-5
"""[m] and [rad] by which an image is widened on each side before its cells are listed. It stands for more than
all rounding, of the law in the robot, of the images, and of the indices here: a checker with other formulas needs the
same cells."""


class Band(NamedTuple):
    """Rows up to a distance, and how they are divided."""

    to: float
    """[m]"""
    growth: float
    """[-] width of a row as a share of its distance"""
    widest: float
    """[m]"""
    alphas: int
    """even number of columns of alpha, all around"""
    betas: int
    """likewise of beta"""
    slice_width: float
    """[rad] of the measured bearing"""


class Table(NamedTuple):
    """Where the cells are; row i is rho in [rho[i], rho[i + 1]]."""

    rho: NDArray[np.float64]
    """(rows + 1,) edges [m]; everything nearer is one set, the inside"""
    alphas: NDArray[np.int64]
    """(rows,) columns of alpha all around; half of them are kept"""
    betas: NDArray[np.int64]
    """(rows,)"""
    slices: NDArray[np.float64]
    """(rows,) [rad]"""
    start: NDArray[np.int64]
    """(rows + 1,) index of the first cell of each row"""


class Boxes(NamedTuple):
    """Images of the cells of some rows."""

    boxes: NDArray[np.float32]
    """(n, 6), widened by PADDING, which is more than their rounding"""
    start: NDArray[np.int64]
    """(cells + 1,)"""


def make_table(inside: float, bands: tuple[Band, ...]) -> Table:
    """Divide the states beyond ``inside`` [m]."""
    edges, alphas, betas, slices = [inside], [], [], []
    for band in bands:
        while edges[-1] < band.to:
            edges.append(edges[-1] + min(band.growth * edges[-1], band.widest))
            alphas.append(band.alphas)
            betas.append(band.betas)
            slices.append(band.slice_width)
    kept = np.array([alpha // 2 * beta for alpha, beta in zip(alphas, betas, strict=True)])
    return Table(
        np.array(edges), np.array(alphas), np.array(betas), np.array(slices), np.concatenate(([0], np.cumsum(kept)))
    )


def with_rows_split(table: Table, split: NDArray[np.bool_]) -> tuple[Table, NDArray[np.int64]]:
    """Halve the marked rows; return the table, and (rows,) the row of the old one that each of its rows is from."""
    old = np.repeat(np.arange(len(split)), np.where(split, 2, 1))
    middles = 0.5 * (table.rho[:-1] + table.rho[1:])[split]
    rho = np.sort(np.concatenate((table.rho, middles)))
    alphas, betas = table.alphas[old], table.betas[old]
    start = np.concatenate(([0], np.cumsum(alphas // 2 * betas)))
    return Table(rho, alphas, betas, table.slices[old], start), old


def cell_of(table: Table, row: int, index: int) -> Cell3:
    """Return a cell of a row."""
    betas = table.betas[row]
    i, j = index // betas, index % betas
    per_alpha, per_beta = 2.0 * math.pi / table.alphas[row], 2.0 * math.pi / betas
    # Widened: the edges are rounded, and the float pi is below pi.
    return Cell3(
        table.rho[row],
        table.rho[row + 1],
        i * per_alpha - 1e-12,
        (i + 1) * per_alpha + 1e-12,
        -math.pi + j * per_beta - 1e-12,
        -math.pi + (j + 1) * per_beta + 1e-12,
    )


def fill_boxes(loop: TunedLoop, table: Table, row: int, work: Any, boxes: Any, counts: Any) -> int:
    """Write the images of the cells of a row to ``boxes``; return their number, -1 if there is no bound."""
    used = 0
    for index in range(len(counts)):
        cell = cell_of(table, row, index)
        number = images(loop, cell, table.slices[row], work)
        if number < 0:
            return -1
        for at in range(number):
            for side in range(3):
                low, high = work[at, 2 * side], work[at, 2 * side + 1]
                if not high - low < math.inf:
                    return -1
                boxes[used, 2 * side], boxes[used, 2 * side + 1] = low - PADDING, high + PADDING
            used += 1
        counts[index] = number
    return used


def kept_index(table: Table, row: int, i: int, j: int) -> int:
    """Return where the cell is kept that holds column i of alpha and j of beta, counted from -pi and beyond it."""
    alphas, betas = table.alphas[row], table.betas[row]
    i, j = i % alphas, j % betas
    if i >= alphas // 2:
        return int(table.start[row] + (i - alphas // 2) * betas + j)
    return int(table.start[row] + (alphas // 2 - 1 - i) * betas + betas - 1 - j)


def columns_of(low: float, high: float, number: int) -> tuple[int, int]:
    """Return the first and the last column of an interval of angles, at most all of them."""
    per_column = number / (2.0 * math.pi)
    first, last = math.floor((low + math.pi) * per_column), math.floor((high + math.pi) * per_column)
    return first, min(last, first + number - 1)


def row_of(rho: Any, distance: float) -> int:
    """Return the row that a distance [m] is in; -1 inside, the number of rows beyond them."""
    low, high = -1, len(rho) - 1
    while low < high:
        middle = (low + high + 1) // 2
        if rho[middle] <= distance:
            low = middle
        else:
            high = middle - 1
    return low


def rank_of_box(table: Table, ranks: Any, box: Any, limit: int) -> int:
    """Largest rank of the cells that a box meets, CORE if it is inside; UNRANKED if one is or if it is beyond them.

    The search ends at a rank of ``limit`` or more.
    """
    first, last = row_of(table.rho, box[0]), row_of(table.rho, box[1])
    if last >= len(table.rho) - 1:
        return UNRANKED
    largest = CORE
    for row in range(last, max(first, 0) - 1, -1):
        i0, i1 = columns_of(box[2], box[3], table.alphas[row])
        j0, j1 = columns_of(box[4], box[5], table.betas[row])
        for i in range(i0, i1 + 1):
            for j in range(j0, j1 + 1):
                rank = ranks[kept_index(table, row, i, j)]
                if rank == UNRANKED:
                    return UNRANKED
                if rank > largest:
                    largest = int(rank)
                    if largest >= limit:
                        return largest
    return largest


def rank_row(table: Table, row: int, boxes: Any, start: Any, ranks: Any) -> int:
    """Rank what can be ranked of a row, until nothing changes; return how many cells were."""
    first, cells = table.start[row], table.start[row + 1] - table.start[row]
    changed, fresh = 0, 1
    while fresh > 0:
        fresh = 0
        for index in range(cells):
            if ranks[first + index] != UNRANKED:
                continue
            largest = CORE
            for at in range(start[index], start[index + 1]):
                rank = rank_of_box(table, ranks, boxes[at], MAX_RANK)
                if rank == UNRANKED:
                    largest = UNRANKED
                    break
                largest = max(largest, rank)
            if largest != UNRANKED and largest < MAX_RANK:
                ranks[first + index] = largest + 1
                fresh += 1
        changed += fresh
    return changed


def spread_core(table: Table, row: int, boxes: Any, start: Any, ranks: Any, done: Any) -> int:
    """Add the cells to the core that its cells of a row lead to; return how many, -1 if beyond the table."""
    first, cells = table.start[row], table.start[row + 1] - table.start[row]
    added = 0
    for index in range(cells):
        if ranks[first + index] != CORE or done[first + index]:
            continue
        done[first + index] = 1
        for at in range(start[index], start[index + 1]):
            box = boxes[at]
            low, high = row_of(table.rho, box[0]), row_of(table.rho, box[1])
            if high >= len(table.rho) - 1:
                return -1
            for to in range(max(low, 0), high + 1):
                i0, i1 = columns_of(box[2], box[3], table.alphas[to])
                j0, j1 = columns_of(box[4], box[5], table.betas[to])
                for i in range(i0, i1 + 1):
                    for j in range(j0, j1 + 1):
                        at_cell = kept_index(table, to, i, j)
                        if ranks[at_cell] != CORE:
                            ranks[at_cell] = CORE
                            added += 1
    return added


fill_kernel = compile_bounds(fill_boxes)
rank_kernel = compile_bounds(rank_row)
spread_kernel = compile_bounds(spread_core)
