"""Makes a certificate of the law ``switching``: chooses cells, finds a core that is not left, and ranks the cells.

From every state whose rank is n, with either end leading and any memory of the law, the robot is in the core after at
most n steps, and stays. A rank is 0 in the core, n > 0 for a cell that leads only to cells of smaller rank, and
UNRANKED as long as that is not shown. The loop is symmetric under a change of the signs of alpha and beta, so only
alpha >= 0 is kept. The result is not trusted: the checker proves it with bounds of its own.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from diffbot_control.law.configuration import SwitchingConfig
from diffbot_control.law.switching import SwitchingLaw
from diffbot_core.errors import DiffbotError, InvalidValueError
from diffbot_lab.stability.compiled import compile_bounds
from diffbot_lab.stability.file import MAX_CELLS, Certificate, Claims, first_cells
from diffbot_lab.stability.maker_bounds import Boxes, MakerLoop, boxes_of_row, local_reach, longest_near, maker_loop
from diffbot_lab.stability.plan import Plan, Requests, check_plan, requesting
from diffbot_sim.jit import law_version

CORE, UNRANKED, MAX_RANK = 0, -1, 32_000
_INWARD = 0.002
"""[m] step of the search for the first edge"""
_FARTHER = 1.02
"""factor of the search for a distance that Omega_L does not outlast: the bounds grow with it, but more slowly"""
_AT_ONCE = 1.25
"""Rows up to this multiple of the innermost row without a rank are halved together."""
_NARROWEST = 0.01
"""share of the longest step; narrower rows are not halved"""
_MOST_CELLS = 12_000_000
"""about 5 GB"""


class Band(NamedTuple):
    """Rows up to a distance, and how they are divided."""

    to: float
    """[m]"""
    growth: float
    """[-] width of a row as a share of its distance"""
    widest: float
    """[m]"""
    alphas: int
    """columns of alpha all around, a multiple of 4"""
    betas: int
    """columns of beta, an even number"""


class Table(NamedTuple):
    """Cells of (rho, alpha, beta); row i is rho in [rho[i], rho[i + 1]]."""

    rho: NDArray[np.float64]
    """(rows + 1,) edges [m]; everything nearer is one set, the inside"""
    alphas: NDArray[np.int64]
    """(rows,) columns of alpha all around; half of them are kept"""
    betas: NDArray[np.int64]
    """(rows,) columns of beta"""
    start: NDArray[np.int64]
    """(rows + 1,) index of the first cell of each row"""


def make_table(inside: float, bands: tuple[Band, ...]) -> Table:
    """Divide the states beyond ``inside`` [m]."""
    edges, alphas, betas = [inside], [], []
    for band in bands:
        while edges[-1] < band.to:
            edges.append(edges[-1] + min(band.growth * edges[-1], band.widest))
            alphas.append(band.alphas)
            betas.append(band.betas)
    columns = np.array(alphas), np.array(betas)
    return Table(np.array(edges), *columns, first_cells(*columns))


def with_rows_split(table: Table, split: NDArray[np.bool_]) -> tuple[Table, NDArray[np.int64]]:
    """Halve the marked rows; return the new table and, for each of its rows, the index of the old row."""
    old = np.repeat(np.arange(len(split)), np.where(split, 2, 1))
    middles = 0.5 * (table.rho[:-1] + table.rho[1:])[split]
    columns = table.alphas[old], table.betas[old]
    return Table(np.sort(np.concatenate((table.rho, middles))), *columns, first_cells(*columns)), old


def kept_index(table: Table, row: int, i: int, j: int) -> int:
    """Return the index of the cell that stands for column i of alpha and j of beta, counted from -pi and beyond."""
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
    """Return the row of a distance [m]; -1 inside, the number of rows beyond them."""
    low, high = -1, len(rho) - 1
    while low < high:
        middle = (low + high + 1) // 2
        if rho[middle] <= distance:
            low = middle
        else:
            high = middle - 1
    return low


def rank_of_box(table: Table, ranks: Any, box: Any) -> int:
    """Return the largest rank of the cells that a box meets, CORE inside; UNRANKED if one has no rank."""
    first, last = row_of(table.rho, box[0]), row_of(table.rho, box[1])
    if last >= len(table.rho) - 1:
        return UNRANKED
    largest = CORE
    for row in range(last, max(first, 0) - 1, -1):
        i0, i1 = columns_of(box[2], box[3], table.alphas[row])
        j0, j1 = columns_of(box[4], box[5], table.betas[row])
        for i in range(i0, i1 + 1):
            for j in range(j0, j1 + 1):
                rank = int(ranks[kept_index(table, row, i, j)])
                if rank == UNRANKED:
                    return UNRANKED
                largest = max(largest, rank)
    return largest


def rank_row(table: Table, row: int, boxes: Any, start: Any, ranks: Any) -> int:
    """Rank the cells of a row whose images have ranks, until nothing changes; return their number."""
    first, cells = table.start[row], table.start[row + 1] - table.start[row]
    changed, fresh = 0, 1
    while fresh > 0:
        fresh = 0
        for index in range(cells):
            if ranks[first + index] != UNRANKED:
                continue
            largest = CORE
            for at in range(start[index], start[index + 1]):
                rank = rank_of_box(table, ranks, boxes[at])
                if rank == UNRANKED or rank >= MAX_RANK:
                    largest = UNRANKED
                    break
                largest = max(largest, rank)
            if largest != UNRANKED:
                ranks[first + index] = largest + 1
                fresh += 1
        changed += fresh
    return changed


def spread_core(table: Table, row: int, boxes: Any, start: Any, ranks: Any, done: Any) -> int:
    """Add the cells that the core's cells of a row lead to; return their number, -1 for a state beyond the table."""
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
                        cell = kept_index(table, to, i, j)
                        if ranks[cell] != CORE:
                            ranks[cell] = CORE
                            added += 1
    return added


rank_kernel = compile_bounds(rank_row)
spread_kernel = compile_bounds(spread_core)


def certify(config: SwitchingConfig, plan: Plan, threads: int | None = None) -> Certificate:
    """Find a core and ranks.

    Args:
        config: of the controller.
        plan: contract, start and cells.
        threads: for the images; None: one per core.

    Raises:
        DiffbotError: if the configuration is not covered, or no certificate is found.
    """
    check_plan(plan)
    law = requesting(config, plan)
    near = holding_radius(law, plan)
    table, seed = table_of(maker_loop(law, plan.at(near + plan.margin)), near, plan)

    def images_of(table: Table, rows: Iterable[int]) -> list[Boxes]:
        return _images_of_rows(lambda rho: maker_loop(law, plan.at(rho)), table, list(rows), threads)

    images = images_of(table, range(len(table.rho) - 1))
    ranks = np.full(int(table.start[-1]), UNRANKED, np.int16)
    ranks[: table.start[int(np.searchsorted(table.rho, seed, side="right"))]] = CORE
    _spread(table, images, ranks)
    _rank(table, images, ranks)
    while (split := rows_to_split(table, ranks, plan.to, plan.period * law.config.data_sheet.v_max)).any():
        finer, old = with_rows_split(table, split)
        # A cell that has a rank keeps it, since both halves lead only to images of the whole.
        ranks = np.concatenate([ranks[table.start[row] : table.start[row + 1]] for row in old])
        table, fresh = finer, np.flatnonzero(split[old])
        images = [images[row] for row in old]
        for row, found in zip(fresh, images_of(table, fresh), strict=True):
            images[row] = found
        _rank(table, images, ranks)
    claims = Claims(core_radius(table, ranks), float(plan.to), steps_from(table, ranks, plan.to), seed)
    return Certificate(plan, config, table.rho, table.alphas, table.betas, ranks, claims, law_version(SwitchingLaw))


def holding_radius(law: Requests, plan: Plan) -> float:
    """Return the true distance [m] within which Omega_L ends, by the contract of a robot within that distance.

    Raises:
        DiffbotError: if there is none within the start: the bounds of the estimate grow too fast.
    """
    within = 0.0
    while within < plan.to:
        here = plan.at(within)
        holding = local_reach(maker_loop(law, here))
        if holding <= within or here == plan:
            return holding
        within = holding * _FARTHER
    raise DiffbotError(f"no certificate: Omega_L may last as far as {plan.to:g} m, where the robot starts")


def table_of(loop: MakerLoop, near: float, plan: Plan) -> tuple[Table, float]:
    """Return the cells of a plan, and the radius [m] of the core's seed, all of which belongs to the core.

    Args:
        loop: by the contract of a robot within the seed.
        near: [m] holding radius.
        plan: contract, start and cells.
    """
    seed = inside = near + plan.margin
    # No step of Omega_G from inside leads beyond the seed.
    while inside > loop.eps_rho and not inside + longest_near(loop, inside + loop.eps_rho) < seed:
        inside -= _INWARD
    if not inside > 1.01 * loop.eps_rho + _INWARD:
        raise DiffbotError("no certificate: Omega_L is too small for the error of the position")
    fine, near_goal = plan.fineness, max(0.7, seed + 0.16)
    bands = (
        Band(near_goal, 0.003 / fine, 0.01, 4 * math.ceil(90 * fine), 2 * math.ceil(40 * fine)),
        Band(max(2.0, near_goal), 0.005, 0.01, 300, 40),
        Band(plan.to + 0.3, 0.008, 0.008, 300, 16),
    )
    table = make_table(inside, bands)
    if table.start[-1] > MAX_CELLS:
        raise InvalidValueError("fineness", plan.fineness, f"less: this makes {table.start[-1]} cells")
    return table, seed


def rows_to_split(table: Table, ranks: NDArray[np.int16], distance: float, longest: float) -> NDArray[np.bool_]:
    """Return the rows (rows,) to halve: the innermost ones without a rank.

    Rows farther out often have no rank only because they lead to these rows.

    Args:
        table: of the cells.
        ranks: of the cells.
        distance: [m] within which all cells need a rank.
        longest: [m] step; rows below a share of it are not halved.
    """
    unranked = np.add.reduceat(ranks == UNRANKED, table.start[:-1]) > 0
    near = table.rho[:-1]
    if not unranked[near < distance].any():
        return np.zeros(len(near), np.bool_)
    first = near[np.argmax(unranked)]
    split = unranked & (near < _AT_ONCE * first) & (np.diff(table.rho) > _NARROWEST * longest)
    if table.start[-1] + np.diff(table.start)[split].sum() > _MOST_CELLS:
        raise DiffbotError(f"no certificate with {_MOST_CELLS} cells: from {first:.4g} m the robot may not come nearer")
    return np.asarray(split)


def core_radius(table: Table, ranks: NDArray[np.int16]) -> float:
    """Return r* [m]: the robot stays within this distance of the goal once it is in the core."""
    rows = np.logical_or.reduceat(ranks == CORE, table.start[:-1])
    return float(table.rho[np.flatnonzero(rows)[-1] + 1] if rows.any() else table.rho[0])


def steps_from(table: Table, ranks: NDArray[np.int16], distance: float) -> int:
    """Return the largest number of steps to the core from any state within ``distance`` [m].

    Raises:
        DiffbotError: if a cell there has no rank.
    """
    ranks = ranks[: table.start[int(np.searchsorted(table.rho, distance))]]
    if (ranks == UNRANKED).any():
        row = int(np.searchsorted(table.start, int(np.argmax(ranks == UNRANKED)), side="right")) - 1
        share = float((ranks == UNRANKED).mean())
        raise DiffbotError(
            f"no certificate: {100.0 * share:.3g} % of the cells, from {table.rho[row]:.4g} m, have no rank: "
            "the errors may cancel the robot's progress there"
        )
    return int(ranks.max(initial=0))


def _images_of_rows(
    loop_at: Callable[[float], MakerLoop], table: Table, rows: list[int], threads: int | None
) -> list[Boxes]:
    def images(row: int) -> Boxes:
        edges = float(table.rho[row]), float(table.rho[row + 1])
        found = boxes_of_row(loop_at(edges[1]), edges, int(table.alphas[row]), int(table.betas[row]))
        if found is None:
            raise DiffbotError(f"no certificate: the period is too long, or cells at {edges[0]:g} m are too large")
        return found

    pool = ThreadPoolExecutor(threads)
    try:
        return list(tqdm(pool.map(images, rows), "images", len(rows), unit="row", disable=None))
    finally:
        pool.shutdown(cancel_futures=True)


def _spread(table: Table, images: list[Boxes], ranks: NDArray[np.int16]) -> None:
    done, added = np.zeros(len(ranks), np.uint8), 1
    while added > 0:
        added = 0
        for row, (boxes, start) in enumerate(images):
            fresh = spread_kernel(table, row, boxes, start, ranks, done)
            if fresh < 0:
                raise DiffbotError(
                    "no certificate: the errors may drive the robot from the goal as far as the cells reach"
                )
            added += fresh


def _rank(table: Table, images: list[Boxes], ranks: NDArray[np.int16]) -> None:
    """Rank row by row until nothing changes."""
    with tqdm(total=len(ranks), initial=int((ranks != UNRANKED).sum()), desc="ranks", unit="cell", disable=None) as bar:
        changed = 1
        while changed > 0:
            changed = 0
            for row, (boxes, start) in enumerate(images):
                fresh = rank_kernel(table, row, boxes, start, ranks)
                changed += fresh
                bar.update(fresh)
