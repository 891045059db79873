"""Check every claim of a certificate of the law ``switching``, independently of its maker.

The core contains all states nearer than the first edge, the cells of rank 0, and Omega_L. No step may lead out of the
core, and a step from a cell with a higher rank may lead to smaller ranks only. The closed loop is symmetric: it does
not change if alpha and beta change their signs. Therefore the file contains the ranks for alpha >= 0 only. The checker
copies these ranks to the cells with alpha < 0, and checks the cells with alpha >= 0.
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
    CheckerLoop,
    box_at,
    checker_loop,
    images,
    local_reach,
    longest_step,
    max_images,
    put_box,
)
from diffbot_lab.stability.compiled import compile_bounds
from diffbot_lab.stability.file import Certificate, first_cells
from diffbot_lab.stability.plan import IdealLaw, ideal_law

TOO_HIGH = 32_767
"""value that represents the rank of a cell without a rank, and of states beyond the cells"""
_LEVELS = 4
"""A cell that does not pass is split into 2 x 2 x 2 parts. Parts that do not pass are split again, up to this depth."""


class Cells(NamedTuple):
    """Edges of the cells, and their ranks for all angles."""

    rho: NDArray[np.float64]
    """(rows + 1,) [m]"""
    alphas: NDArray[np.int64]
    """(rows,) number of columns of alpha from -pi to pi"""
    betas: NDArray[np.int64]
    """(rows,) number of columns of beta from -pi to pi"""
    start: NDArray[np.int64]
    """(rows + 1,) index of the first cell of each row; within a row the cells are ordered by alpha, then by beta"""
    ranks: NDArray[np.int16]
    """(cells,) TOO_HIGH for a cell without a rank"""


def verify(certificate: Certificate) -> None:
    """Check every claim of a certificate.

    Raises:
        DiffbotError: naming the first claim that is not proved.
    """
    law = ideal_law(certificate.config, certificate.plan)
    loop = checker_loop(law, certificate.plan.at(certificate.claims.seed))
    _check_claims(certificate)
    _check_near(certificate, loop)
    _check_cells(certificate, law)


def _check_claims(certificate: Certificate) -> None:
    """Check that the claims follow from the ranks."""
    claims, rho, ranks = certificate.claims, certificate.rho, certificate.ranks
    first = first_cells(certificate.alphas, certificate.betas)

    def ranks_within(distance: float) -> NDArray[np.int16]:
        return ranks[: first[int((rho[:-1] <= distance).sum())]]

    if not (claims.seed < rho[-1] and (ranks_within(claims.seed) == 0).all()):
        raise DiffbotError(
            f"not verified: claims.seed = {claims.seed:g} m, but not all states within it are in the core"
        )
    core = np.flatnonzero(ranks == 0)
    core_end = rho[np.searchsorted(first, core[-1], side="right")] if len(core) else rho[0]
    if not max(core_end, claims.seed) <= claims.radius:
        raise DiffbotError(f"not verified: claims.radius = {claims.radius:g} m, but the core reaches {core_end:g} m")
    if not (claims.start < rho[-1] and (ranks_within(claims.start) >= 0).all()):
        raise DiffbotError(f"not verified: claims.start = {claims.start:g} m, but a cell within it has no rank")
    if not ranks_within(claims.start).max(initial=0) <= claims.steps:
        raise DiffbotError(f"not verified: claims.steps = {claims.steps}, but a cell within start has a higher rank")


def _check_near(certificate: Certificate, loop: CheckerLoop) -> None:
    """Check that steps in Omega_L, departures, and steps from nearer than the first edge end within the seed radius.

    The loop has the contract that holds within the seed radius. After a departure the direction of travel may change.
    This does not matter, because all states within the seed radius are in the core, for both directions.
    """
    inside, seed, farthest = float(certificate.rho[0]), certificate.claims.seed, local_reach(loop)
    if not farthest <= seed:
        raise DiffbotError(f"not verified: claims.seed = {seed:g} m, but Omega_L may lead to {farthest:.4f} m")
    if not inside > 1.01 * loop.eps_rho:
        raise DiffbotError(f"not verified: rho begins at {inside:g} m, but must be above {1.01 * loop.eps_rho:g} m")
    reach = inside + longest_step(loop, inside + loop.eps_rho)
    if not reach <= seed:
        raise DiffbotError(f"not verified: a step from within {inside:g} m may lead to {reach:.4f} m, beyond the seed")


def _check_cells(certificate: Certificate, law: IdealLaw) -> None:
    """Check that every cell with a rank leads only to smaller ranks, and that the core leads only to the core."""
    cells, rows = cells_of(certificate), range(len(certificate.alphas))
    loops = [checker_loop(law, certificate.plan.at(float(rho))) for rho in certificate.rho[1:]]
    pool = ThreadPoolExecutor()
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
    """Return the ranks of a certificate for all angles; the rank of a cell without a rank becomes TOO_HIGH."""
    rho, alphas, betas, ranks = certificate.rho, certificate.alphas, certificate.betas, certificate.ranks
    kept = first_cells(alphas, betas)
    unfolded = np.empty(2 * len(ranks), np.int16)
    for row in range(len(alphas)):
        block = ranks[kept[row] : kept[row + 1]].reshape(alphas[row] // 2, betas[row])
        unfolded[2 * kept[row] : 2 * kept[row + 1]] = np.concatenate([block[::-1, ::-1], block]).ravel()
    unfolded[unfolded < 0] = TOO_HIGH
    return Cells(rho, alphas, betas, 2 * kept, unfolded)


def row_at(cells: Cells, rho: float) -> int:
    """Return the row of a distance [m]: -1 nearer than the first row, the number of rows beyond the last row."""
    low, high = 0, len(cells.rho)
    while low < high:
        middle = (low + high) // 2
        if rho < cells.rho[middle]:
            high = middle
        else:
            low = middle + 1
    return low - 1


def rank_at(cells: Cells, rho: float, alpha: float, beta: float) -> int:
    """Return the rank of a state."""
    row = row_at(cells, rho)
    if row < 0:
        return 0
    if row >= len(cells.alphas):
        return TOO_HIGH
    i = math.floor((alpha + math.pi) / (2.0 * math.pi) * cells.alphas[row]) % cells.alphas[row]
    j = math.floor((beta + math.pi) / (2.0 * math.pi) * cells.betas[row]) % cells.betas[row]
    return int(cells.ranks[cells.start[row] + i * cells.betas[row] + j])


def keeps_below(cells: Cells, states: Box, allowed: int) -> bool:
    """Return True if no cell that overlaps or touches a box of states has a rank above ``allowed``.

    Args:
        cells: cells with ranks.
        states: box of states. Its angles are not wrapped.
        allowed: largest rank.
    """
    last = row_at(cells, states.r1 + SLACK)
    if last >= len(cells.alphas):
        return False
    for row in range(last, max(row_at(cells, states.r0 - SLACK), 0) - 1, -1):
        alphas, betas = cells.alphas[row], cells.betas[row]
        i, alpha_count = _columns(states.a0, states.a1, alphas)
        first, beta_count = _columns(states.b0, states.b1, betas)
        for _ in range(alpha_count):
            at = cells.start[row] + i * betas
            j = first
            for _ in range(beta_count):
                if cells.ranks[at + j] > allowed:
                    return False
                j = j + 1 if j + 1 < betas else 0
            i = i + 1 if i + 1 < alphas else 0
    return True


def _columns(low: float, high: float, number: int) -> tuple[int, int]:
    """Return the first column that overlaps an interval of angles, and the number of overlapping columns."""
    per_radian = number / (2.0 * math.pi)
    first = math.floor((low - SLACK + math.pi) * per_radian)
    last = math.floor((high + SLACK + math.pi) * per_radian)
    return first % number, min(last - first + 1, number)


def leads_below(loop: CheckerLoop, cells: Cells, box: Box, allowed: int, work: Any) -> bool:
    """Return True if every step of Omega_G from a box of states leads to a rank of at most ``allowed``.

    ``work`` is an array for the result of :func:`images`.
    """
    number = images(loop, box, work)
    at = 0
    while at < number and keeps_below(cells, box_at(work[at]), allowed):
        at += 1
    return at == number


def first_failing(loop: CheckerLoop, cells: Cells, row: int) -> int:
    """Return the index of the first cell of a row that fails, and -1 if all cells pass.

    A cell with a rank above 0 fails if it may lead to a rank that is not smaller. A cell of the core fails if it may
    lead out of the core.
    """
    alphas, betas = cells.alphas[row], cells.betas[row]
    waiting = np.empty((8 * _LEVELS + 1, 6))
    levels = np.empty(8 * _LEVELS + 1, np.int64)
    smallest = cell_box(cells, row, 0)
    for _ in range(_LEVELS):
        smallest = eighth(smallest, 0)
    # The smallest part with the smallest distance has the most slices.
    work = np.empty((max_images(loop, smallest), 6))
    for index in range(alphas // 2 * betas):
        rank = cells.ranks[cells.start[row] + alphas // 2 * betas + index]
        if rank == TOO_HIGH:
            continue
        allowed = max(rank - 1, 0)
        put_box(waiting[0], cell_box(cells, row, index))
        levels[0], number = 0, 1
        while number > 0:
            number -= 1
            box, level = box_at(waiting[number]), levels[number]
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
    """Return a closed box that contains a stored cell. SLACK is larger than the rounding errors of the edges."""
    i, j = index // cells.betas[row], index % cells.betas[row]
    alpha_width, beta_width = 2.0 * math.pi / cells.alphas[row], 2.0 * math.pi / cells.betas[row]
    return Box(
        cells.rho[row],
        cells.rho[row + 1],
        i * alpha_width - SLACK,
        (i + 1) * alpha_width + SLACK,
        j * beta_width - math.pi - SLACK,
        (j + 1) * beta_width - math.pi + SLACK,
    )


def eighth(box: Box, part: int) -> Box:
    """Return one of the 2 x 2 x 2 parts of a box."""
    r, a, b = 0.5 * (box.r0 + box.r1), 0.5 * (box.a0 + box.a1), 0.5 * (box.b0 + box.b1)
    r0, r1 = (box.r0, r) if part % 2 == 0 else (r, box.r1)
    a0, a1 = (box.a0, a) if part // 2 % 2 == 0 else (a, box.a1)
    b0, b1 = (box.b0, b) if part // 4 == 0 else (b, box.b1)
    return Box(r0, r1, a0, a1, b0, b1)


failing_kernel = compile_bounds(first_failing)
