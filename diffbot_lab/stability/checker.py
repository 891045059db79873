"""Checks every claim of a certificate of the law ``switching``, independently of its maker.

The core is everything nearer than the first edge, the cells of rank 0, and Omega_L. Nothing may lead out of the core,
and every other cell with a rank only to smaller ranks. The loop does not change if alpha and beta change their signs,
so the file keeps the ranks of alpha >= 0 only. Here they are unfolded to all around, and the kept cells are checked.
"""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from diffbot_core.errors import DiffbotError
from diffbot_lab.stability.checker_bounds import (
    SLACK,
    Box,
    Numbers,
    farthest_local,
    images,
    longest_step,
    most_images,
    numbers_of,
    put_box,
    taken,
)
from diffbot_lab.stability.compiled import compile_bounds
from diffbot_lab.stability.file import Certificate, first_cells
from diffbot_lab.stability.plan import Requests, requesting

TOO_HIGH = 32_767
"""rank of a cell without a rank, and of states beyond the cells"""
_LEVELS = 4
"""A cell that does not pass is split into 2 x 2 x 2 parts, and each part again, up to this depth."""


class Cells(NamedTuple):
    """Edges, and the ranks all around."""

    rho: NDArray[np.float64]
    """(rows + 1,) [m]"""
    alphas: NDArray[np.int64]
    """(rows,) columns of alpha, -pi to pi"""
    betas: NDArray[np.int64]
    """(rows,) columns of beta, -pi to pi"""
    start: NDArray[np.int64]
    """(rows + 1,) the first cell of each row; then by alpha, by beta"""
    ranks: NDArray[np.int16]
    """(cells,) TOO_HIGH for a cell without a rank"""


def verify(certificate: Certificate, threads: int | None = None) -> None:
    """Check every claim of a certificate.

    Args:
        certificate: as read.
        threads: None: one per core.

    Raises:
        DiffbotError: naming the first thing that is not proved.
    """
    law = requesting(certificate.config, certificate.plan)
    loop = numbers_of(law, certificate.plan.at(certificate.claims.seed))
    _check_claims(certificate)
    _check_near(certificate, loop)
    _check_cells(certificate, law, threads)


def _check_claims(certificate: Certificate) -> None:
    """Refuse claims that are better than the ranks."""
    claims, rho, ranks = certificate.claims, certificate.rho, certificate.ranks
    first = first_cells(certificate.alphas, certificate.betas)

    def within(distance: float) -> NDArray[np.int16]:
        return ranks[: first[int((rho[:-1] <= distance).sum())]]

    if not (claims.seed < rho[-1] and (within(claims.seed) == 0).all()):
        raise DiffbotError(f"not verified: claims.seed = {claims.seed:g} m, not all within it is in the core")
    core = np.flatnonzero(ranks == 0)
    farthest = rho[np.searchsorted(first, core[-1], side="right")] if len(core) else rho[0]
    if not max(farthest, claims.seed) <= claims.radius:
        raise DiffbotError(f"not verified: claims.radius = {claims.radius:g} m, the core reaches {farthest:g} m")
    if not (claims.start < rho[-1] and (within(claims.start) >= 0).all()):
        raise DiffbotError(f"not verified: claims.start = {claims.start:g} m, a cell within it has no rank")
    if not within(claims.start).max(initial=0) <= claims.steps:
        raise DiffbotError(f"not verified: claims.steps = {claims.steps}, a cell within the start has a higher rank")


def _check_near(certificate: Certificate, loop: Numbers) -> None:
    """Omega_L, departures, and steps of Omega_G from nearer than the first edge end within the seed of the core.

    The contract is that of a robot within the seed. A departure puts Omega_G in force and may choose another course:
    all states within the seed are in the core, whichever end leads.
    """
    inside, seed, farthest = float(certificate.rho[0]), certificate.claims.seed, farthest_local(loop)
    if not farthest <= seed:
        raise DiffbotError(f"not verified: claims.seed = {seed:g} m, Omega_L may lead to {farthest:.4f} m")
    if not inside > 1.01 * loop.eps_rho:
        raise DiffbotError(f"not verified: rho begins at {inside:g} m, must be above {1.01 * loop.eps_rho:g} m")
    reach = inside + longest_step(loop, inside + loop.eps_rho)
    if not reach <= seed:
        raise DiffbotError(f"not verified: a step from within {inside:g} m may lead to {reach:.4f} m, beyond the seed")


def _check_cells(certificate: Certificate, law: Requests, threads: int | None) -> None:
    """Every cell with a rank leads only to smaller ranks, or stays in the core."""
    cells, rows = cells_of(certificate), range(len(certificate.alphas))
    loops = [numbers_of(law, certificate.plan.at(float(rho))) for rho in certificate.rho[1:]]
    pool = ThreadPoolExecutor(threads)
    try:
        found = pool.map(lambda row: int(failing_kernel(loops[row], cells, row)), rows)
        for row, failing in zip(rows, tqdm(found, "verify", len(rows), unit="row", disable=None), strict=True):
            if failing >= 0:
                rank = certificate.ranks[first_cells(certificate.alphas, certificate.betas)[row] + failing]
                r0, r1, a0, a1, b0, b1 = cell_box(cells, row, failing)
                raise DiffbotError(
                    f"not verified: the cell rho {r0:.4f} to {r1:.4f} m, alpha {a0:.4f} to {a1:.4f} rad, "
                    f"beta {b0:.4f} to {b1:.4f} rad, of rank {rank}, "
                    f"may {'leave the core' if rank == 0 else 'lead to a rank that is not smaller'}"
                )
    finally:
        pool.shutdown(cancel_futures=True)


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


def leads_below(loop: Numbers, cells: Cells, box: Box, allowed: int, work: Any) -> bool:
    """True if one step of Omega_G from any state of a box leads to a rank of at most ``allowed``.

    ``work`` is the array for :func:`images`.
    """
    number = images(loop, box, work)
    at = 0
    while at < number and keeps_below(cells, taken(work[at]), allowed):
        at += 1
    return at == number


def first_failing(loop: Numbers, cells: Cells, row: int) -> int:
    """Return the first cell of a row, of those kept, that may lead to a rank that is not smaller; -1 for none.

    From a cell of the core only the core may be reached.
    """
    alphas, betas = cells.alphas[row], cells.betas[row]
    waiting = np.empty((8 * _LEVELS + 1, 6))
    levels = np.empty(8 * _LEVELS + 1, np.int64)
    smallest = cell_box(cells, row, 0)
    for _ in range(_LEVELS):
        smallest = eighth(smallest, 0)
    # The smallest and nearest parts have the most slices.
    work = np.empty((most_images(loop, smallest), 6))
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
            if leads_below(loop, cells, box, allowed, work):
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


failing_kernel = compile_bounds(first_failing)
