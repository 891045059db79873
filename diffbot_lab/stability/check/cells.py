"""The cells of a certificate and their ranks; whether each cell leads only to smaller ranks.

The loop does not change if alpha and beta change their signs, so the file keeps the ranks of alpha >= 0 only. Here they
are unfolded to all around, and the cells kept are checked.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from diffbot_lab.stability.check.commands import SLACK, Numbers, command_of
from diffbot_lab.stability.check.steps import (
    Box,
    after,
    clipped,
    measured_as,
    motion_of,
    slice_count,
    slice_of,
    with_beta,
)
from diffbot_lab.stability.compiled import compile_bounds
from diffbot_lab.stability.file import Certificate, first_cells

TOO_HIGH = 32_767
"""rank of what has none, and of what lies beyond the cells"""
_SLICE = 2.5
"""width of the slices of the measured bearing, in widths of a cell"""
_LEVELS = 4
"""A cell that does not pass is split into 2 x 2 x 2 parts, each of which is split again if need be, so many times."""
_NEAREST, _LONGEST, _WIDEST = 0.01, 0.45, 1.0
"""what the formulas cover: measured distance [m], chord as a share of the distance, rotation [rad]"""


class Cells(NamedTuple):
    """Edges, and the ranks all around."""

    rho: NDArray[np.float64]
    """(rows + 1,) [m]"""
    alphas: NDArray[np.int64]
    """(rows,) columns of alpha, -pi to pi"""
    betas: NDArray[np.int64]
    """(rows,)"""
    start: NDArray[np.int64]
    """(rows + 1,) the first cell of each row; then by alpha, by beta"""
    ranks: NDArray[np.int16]


def cells_of(certificate: Certificate) -> Cells:
    """Unfold the ranks of a certificate; no rank is TOO_HIGH."""
    rho, alphas, betas, ranks = certificate.rho, certificate.alphas, certificate.betas, certificate.ranks
    kept = first_cells(alphas, betas)
    around = np.empty(2 * len(ranks), np.int16)
    for row in range(len(alphas)):
        block = ranks[kept[row] : kept[row + 1]].reshape(alphas[row] // 2, betas[row])
        around[2 * kept[row] : 2 * kept[row + 1]] = np.concatenate([block[::-1, ::-1], block]).ravel()
    around[around < 0] = TOO_HIGH
    return Cells(rho, alphas, betas, 2 * kept, around)


def row_at(cells: Cells, rho: float) -> int:
    """Return the row that a distance [m] is in; -1 if nearer than all, the number of rows if farther or no number."""
    low, high = 0, len(cells.rho)
    while low < high:
        middle = (low + high) // 2
        if rho < cells.rho[middle]:
            high = middle
        else:
            low = middle + 1
    return low - 1


def rank_at(cells: Cells, rho: float, alpha: float, beta: float) -> int:
    """Rank of a state."""
    row = row_at(cells, rho)
    if row < 0:
        return 0
    if row >= len(cells.alphas):
        return TOO_HIGH
    i = math.floor((alpha + math.pi) / (2.0 * math.pi) * cells.alphas[row]) % cells.alphas[row]
    j = math.floor((beta + math.pi) / (2.0 * math.pi) * cells.betas[row]) % cells.betas[row]
    return int(cells.ranks[cells.start[row] + i * cells.betas[row] + j])


def keeps_below(cells: Cells, states: Box, allowed: int) -> bool:
    """Tell if all cells that a box of states meets have at most a rank; a cell that is only touched counts.

    Args:
        cells: with ranks.
        states: angles not wrapped.
        allowed: the rank.
    """
    last = row_at(cells, states.r1 + SLACK)
    if last >= len(cells.alphas):
        return False
    for row in range(last, max(row_at(cells, states.r0 - SLACK), 0) - 1, -1):
        alphas, betas = cells.alphas[row], cells.betas[row]
        i, wide = _columns(states.a0, states.a1, alphas)
        first, high = _columns(states.b0, states.b1, betas)
        for _ in range(wide):
            at = cells.start[row] + i * betas
            j = first
            for _ in range(high):
                if cells.ranks[at + j] > allowed:
                    return False
                j = j + 1 if j + 1 < betas else 0
            i = i + 1 if i + 1 < alphas else 0
    return True


def _columns(low: float, high: float, number: int) -> tuple[int, int]:
    """Return the first column that an interval of angles meets, and how many."""
    per_radian = number / (2.0 * math.pi)
    first = math.floor((low - SLACK + math.pi) * per_radian)
    last = math.floor((high + SLACK + math.pi) * per_radian)
    return first % number, min(last - first + 1, number)


def leads_below(loop: Numbers, cells: Cells, box: Box, allowed: int) -> bool:
    """Tell if one step of Omega_G from any state of a box leads to a rank of at most ``allowed``.

    False also where the formulas do not hold: if the goal may be measured at the robot itself, or a step is too long.
    """
    parts = slice_count(loop, box, _SLICE * (box.a1 - box.a0))
    for part in range(parts):
        one = slice_of(loop, box, part, parts)
        if not one.possible:
            continue
        if not one.near > _NEAREST:
            return False
        for others in range(-1, 2):
            d0, d1, p, q = with_beta(loop, box, one, others)
            for turns in range(-1, 2):
                alpha, beta = clipped(p, q, turns), clipped(box.b0 + d0, box.b1 + d1, others)
                if d0 > d1 or alpha[0] > alpha[1] or beta[0] > beta[1]:
                    continue
                u0, u1, z0, z1 = motion_of(loop, command_of(loop, (one.near, one.far), alpha, beta))
                if not (max(abs(u0), abs(u1)) < _LONGEST * box.r0 and max(abs(z0), abs(z1)) < _WIDEST):
                    return False
                if not keeps_below(cells, after(loop, measured_as(loop, box, alpha, turns), u0, u1, z0, z1), allowed):
                    return False
    return True


def first_failing(loop: Numbers, cells: Cells, row: int) -> int:
    """Return the first cell of a row, of those kept, that may lead to a rank that is not smaller; -1 for none.

    From a cell of the core only the core may be reached.
    """
    alphas, betas = cells.alphas[row], cells.betas[row]
    waiting = np.empty((8 * _LEVELS + 1, 6))
    levels = np.empty(8 * _LEVELS + 1, np.int64)
    for index in range(alphas // 2 * betas):
        rank = cells.ranks[cells.start[row] + alphas // 2 * betas + index]
        if rank == TOO_HIGH:
            continue
        allowed = max(rank - 1, 0)
        put_box(waiting[0], cell_box(cells, row, index))
        levels[0], number = 0, 1
        while number > 0:
            number -= 1
            box, level = taken(waiting[number]), levels[number]
            if leads_below(loop, cells, box, allowed):
                continue
            if level == _LEVELS:
                return index
            for part in range(8):
                put_box(waiting[number], eighth(box, part))
                levels[number] = level + 1
                number += 1
    return -1


def cell_box(cells: Cells, row: int, index: int) -> Box:
    """Return a cell of those kept, closed; its edges are rounded."""
    i, j = index // cells.betas[row], index % cells.betas[row]
    wide, high = 2.0 * math.pi / cells.alphas[row], 2.0 * math.pi / cells.betas[row]
    return Box(
        cells.rho[row],
        cells.rho[row + 1],
        i * wide - SLACK,
        (i + 1) * wide + SLACK,
        j * high - math.pi - SLACK,
        (j + 1) * high - math.pi + SLACK,
    )


def eighth(box: Box, part: int) -> Box:
    """Return one of the 2 x 2 x 2 parts of a box."""
    r, a, b = 0.5 * (box.r0 + box.r1), 0.5 * (box.a0 + box.a1), 0.5 * (box.b0 + box.b1)
    r0, r1 = (box.r0, r) if part % 2 == 0 else (r, box.r1)
    a0, a1 = (box.a0, a) if part // 2 % 2 == 0 else (a, box.a1)
    b0, b1 = (box.b0, b) if part // 4 == 0 else (b, box.b1)
    return Box(r0, r1, a0, a1, b0, b1)


def put_box(place: Any, box: Box) -> None:
    """Write a box to a row of an array."""
    place[0], place[1], place[2], place[3], place[4], place[5] = box


def taken(place: Any) -> Box:
    """Return the box in a row of an array."""
    return Box(place[0], place[1], place[2], place[3], place[4], place[5])


failing_kernel = compile_bounds(first_failing)
