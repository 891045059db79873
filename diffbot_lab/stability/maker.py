"""Make a certificate of the law ``switching``: choose cells, find a core that the robot does not leave, rank the cells.

From every state of rank n, with either direction of travel and any memory of the law, the robot reaches the core after
at most n steps, and stays there. Cells of the core have rank 0. A cell has rank n > 0 if it leads only to cells of
smaller rank. All other cells are UNRANKED. The closed loop does not change if alpha and beta change their signs, so
only the cells with alpha >= 0 are stored. The checker proves the result with bounds of its own.
"""

from __future__ import annotations

import math
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
from diffbot_lab.stability.plan import IdealLaw, Plan, check_plan, ideal_law
from diffbot_sim.jit import law_version

CORE, UNRANKED, MAX_RANK = 0, -1, 32_000
_EDGE_STEP = 0.002
"""[m] step of the search for the first edge"""
_HOLDING_FACTOR = 1.02
"""factor between two values in the search for the holding radius"""
_SPLIT_REACH = 1.25
"""Rows with unranked cells are halved together, up to this multiple of the distance of the innermost such row."""
_MIN_ROW = 0.01
"""Rows narrower than this share of the longest step are not halved."""
_CELL_LIMIT = 12_000_000
"""largest number of cells, about 5 GB"""


class Band(NamedTuple):
    """A range of distances whose rows have the same number of columns."""

    to: float
    """[m] largest distance"""
    growth: float
    """[-] width of a row as a share of its distance"""
    max_width: float
    """[m] largest width of a row"""
    alphas: int
    """number of columns of alpha from -pi to pi, a multiple of 4"""
    betas: int
    """number of columns of beta from -pi to pi, even"""


class Table(NamedTuple):
    """Cells of (rho, alpha, beta). Row i contains the cells with rho in [rho[i], rho[i + 1]]."""

    rho: NDArray[np.float64]
    """(rows + 1,) edges [m]; all states nearer than the first edge are in the core"""
    alphas: NDArray[np.int64]
    """(rows,) number of columns of alpha from -pi to pi; half of them are stored"""
    betas: NDArray[np.int64]
    """(rows,) number of columns of beta from -pi to pi"""
    start: NDArray[np.int64]
    """(rows + 1,) index of the first cell of each row"""


def make_table(inside: float, bands: tuple[Band, ...]) -> Table:
    """Divide the states beyond the distance ``inside`` [m] into cells."""
    edges, alphas, betas = [inside], [], []
    for band in bands:
        while edges[-1] < band.to:
            edges.append(edges[-1] + min(band.growth * edges[-1], band.max_width))
            alphas.append(band.alphas)
            betas.append(band.betas)
    columns = np.array(alphas), np.array(betas)
    return Table(np.array(edges), *columns, first_cells(*columns))


def with_rows_split(table: Table, split: NDArray[np.bool_]) -> tuple[Table, NDArray[np.int64]]:
    """Halve the marked rows. Return the new table, and the index of the old row for each new row."""
    old = np.repeat(np.arange(len(split)), np.where(split, 2, 1))
    middles = 0.5 * (table.rho[:-1] + table.rho[1:])[split]
    columns = table.alphas[old], table.betas[old]
    return Table(np.sort(np.concatenate((table.rho, middles))), *columns, first_cells(*columns)), old


def stored_index(table: Table, row: int, i: int, j: int) -> int:
    """Return the index of the cell in column i of alpha and column j of beta.

    Columns are counted from -pi, and wrap around. A cell with alpha < 0 has the index of its mirror image.
    """
    alphas, betas = table.alphas[row], table.betas[row]
    i, j = i % alphas, j % betas
    if i >= alphas // 2:
        return int(table.start[row] + (i - alphas // 2) * betas + j)
    return int(table.start[row] + (alphas // 2 - 1 - i) * betas + betas - 1 - j)


def columns_of(low: float, high: float, number: int) -> tuple[int, int]:
    """Return the first and the last column that overlap an interval of angles; at most ``number`` columns."""
    per_column = number / (2.0 * math.pi)
    first, last = math.floor((low + math.pi) * per_column), math.floor((high + math.pi) * per_column)
    return first, min(last, first + number - 1)


def row_of(rho: Any, distance: float) -> int:
    """Return the row of a distance [m]: -1 nearer than the first row, the number of rows beyond the last row."""
    low, high = -1, len(rho) - 1
    while low < high:
        middle = (low + high + 1) // 2
        if rho[middle] <= distance:
            low = middle
        else:
            high = middle - 1
    return low


def rank_of_box(table: Table, ranks: Any, box: Any) -> int:
    """Return the largest rank of the cells that overlap a box; UNRANKED if one of these cells has no rank.

    States nearer than the first row have the rank CORE.
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
                rank = int(ranks[stored_index(table, row, i, j)])
                if rank == UNRANKED:
                    return UNRANKED
                largest = max(largest, rank)
    return largest


def rank_row(table: Table, row: int, boxes: Any, start: Any, ranks: Any) -> int:
    """Rank each cell of a row whose images all have ranks, until nothing changes. Return the number of new ranks."""
    first, cells = table.start[row], table.start[row + 1] - table.start[row]
    ranked, fresh = 0, 1
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
        ranked += fresh
    return ranked


def spread_core(table: Table, row: int, boxes: Any, start: Any, ranks: Any, done: Any) -> int:
    """Add to the core all cells that overlap images of the core's cells in a row.

    Returns:
        The number of cells that were added; -1 if an image reaches beyond the table.
    """
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
                        cell = stored_index(table, to, i, j)
                        if ranks[cell] != CORE:
                            ranks[cell] = CORE
                            added += 1
    return added


rank_kernel = compile_bounds(rank_row)
spread_kernel = compile_bounds(spread_core)


def certify(config: SwitchingConfig, plan: Plan, threads: int | None = None) -> Certificate:
    """Make a certificate: find the core and the ranks.

    Args:
        config: configuration of the controller.
        plan: contract, start and cells.
        threads: number of threads that compute images; None means one per core.

    Raises:
        DiffbotError: if the configuration is not covered, or no certificate is found.
    """
    check_plan(plan)
    law = ideal_law(config, plan)
    near = holding_radius(law, plan)
    table, seed = table_of(maker_loop(law, plan.at(near + plan.margin)), near, plan)
    images = _images_of_rows(law, plan, table, np.arange(len(table.rho) - 1), threads)
    ranks = np.full(int(table.start[-1]), UNRANKED, np.int16)
    ranks[: table.start[int(np.searchsorted(table.rho, seed, side="right"))]] = CORE
    _spread_core(table, images, ranks)
    _rank_cells(table, images, ranks)
    while (split := rows_to_split(table, ranks, plan.to, plan.period * law.config.data_sheet.v_max)).any():
        finer, old = with_rows_split(table, split)
        # Both halves of a cell lead only to images of the whole cell, so they keep its rank.
        ranks = np.concatenate([ranks[table.start[row] : table.start[row + 1]] for row in old])
        images = [images[row] for row in old]
        table, halves = finer, np.flatnonzero(split[old])
        for row, boxes in zip(halves, _images_of_rows(law, plan, table, halves, threads), strict=True):
            images[row] = boxes
        _rank_cells(table, images, ranks)
    claims = Claims(core_radius(table, ranks), float(plan.to), steps_from(table, ranks, plan.to), seed)
    return Certificate(plan, config, table.rho, table.alphas, table.betas, ranks, claims, law_version(SwitchingLaw))


def holding_radius(law: IdealLaw, plan: Plan) -> float:
    """Return the holding radius [m]: no step in Omega_L leads to a larger true distance.

    The contract is the contract at this radius, since its bounds may grow with the distance.

    Raises:
        DiffbotError: if the radius is not below ``plan.to``, because the bounds of the estimate grow too fast.
    """
    within = 0.0
    while within < plan.to:
        here = plan.at(within)
        holding = local_reach(maker_loop(law, here))
        if holding <= within or here == plan:
            return holding
        within = holding * _HOLDING_FACTOR
    raise DiffbotError(
        f"no certificate: Omega_L may stay in force as far as {plan.to:g} m, where the robot starts; "
        "reduce the slopes of the contract"
    )


def table_of(loop: MakerLoop, near: float, plan: Plan) -> tuple[Table, float]:
    """Return the cells of a plan, and the seed radius [m]. All states within the seed radius belong to the core.

    Args:
        loop: loop with the contract that holds within the seed radius.
        near: [m] holding radius.
        plan: contract, start and cells.
    """
    seed = inside = near + plan.margin
    # No step of Omega_G that begins nearer than the first edge may lead beyond the seed radius.
    while inside > loop.eps_rho and not inside + longest_near(loop, inside + loop.eps_rho) < seed:
        inside -= _EDGE_STEP
    if not inside > 1.01 * loop.eps_rho + _EDGE_STEP:
        raise DiffbotError(
            "no certificate: Omega_L is too small for the position error; reduce eps_position or raise the margin"
        )
    fine, near_goal = plan.fineness, max(0.7, seed + 0.16)
    bands = (
        Band(near_goal, 0.003 / fine, 0.01, 4 * math.ceil(90 * fine), 2 * math.ceil(40 * fine)),
        Band(max(2.0, near_goal), 0.005, 0.01, 300, 40),
        Band(plan.to + 0.3, 0.008, 0.008, 300, 16),
    )
    table = make_table(inside, bands)
    if table.start[-1] > MAX_CELLS:
        raise InvalidValueError(
            "fineness", plan.fineness, f"smaller: it gives {table.start[-1]} cells, and at most {MAX_CELLS} are allowed"
        )
    return table, seed


def rows_to_split(table: Table, ranks: NDArray[np.int16], distance: float, longest: float) -> NDArray[np.bool_]:
    """Return (rows,), True for each row to halve.

    These are the innermost rows with unranked cells. Rows farther out often have unranked cells only because they lead
    to the innermost rows.

    Args:
        table: cells.
        ranks: ranks of the cells.
        distance: [m] distance within which all cells need a rank.
        longest: [m] longest step.

    Raises:
        DiffbotError: if the table would have too many cells.
    """
    unranked = np.add.reduceat(ranks == UNRANKED, table.start[:-1]) > 0
    near = table.rho[:-1]
    if not unranked[near < distance].any():
        return np.zeros(len(near), np.bool_)
    first = near[np.argmax(unranked)]
    split = unranked & (near < _SPLIT_REACH * first) & (np.diff(table.rho) > _MIN_ROW * longest)
    if table.start[-1] + np.diff(table.start)[split].sum() > _CELL_LIMIT:
        raise DiffbotError(
            f"no certificate with {_CELL_LIMIT} cells: the errors may cancel the robot's progress at {first:.4g} m"
        )
    return np.asarray(split)


def core_radius(table: Table, ranks: NDArray[np.int16]) -> float:
    """Return r* [m], the largest distance from the goal in the core."""
    rows = np.logical_or.reduceat(ranks == CORE, table.start[:-1])
    return float(table.rho[np.flatnonzero(rows)[-1] + 1] if rows.any() else table.rho[0])


def steps_from(table: Table, ranks: NDArray[np.int16], distance: float) -> int:
    """Return the largest number of steps to the core from within ``distance`` [m] of the goal.

    Raises:
        DiffbotError: if a cell within this distance has no rank.
    """
    ranks = ranks[: table.start[int(np.searchsorted(table.rho, distance))]]
    if (ranks == UNRANKED).any():
        row = int(np.searchsorted(table.start, int(np.argmax(ranks == UNRANKED)), side="right")) - 1
        share = float((ranks == UNRANKED).mean())
        raise DiffbotError(
            f"no certificate: {100.0 * share:.3g} % of the cells have no rank, the nearest at {table.rho[row]:.4g} m: "
            "the errors may cancel the robot's progress there"
        )
    return int(ranks.max(initial=0))


def _images_of_rows(
    law: IdealLaw, plan: Plan, table: Table, rows: NDArray[np.int_], threads: int | None
) -> list[Boxes]:
    def images(row: int) -> Boxes:
        edges = float(table.rho[row]), float(table.rho[row + 1])
        loop = maker_loop(law, plan.at(edges[1]))
        boxes = boxes_of_row(loop, edges, int(table.alphas[row]), int(table.betas[row]))
        if boxes is None:
            raise DiffbotError(
                f"no certificate: the next state is not bounded for the cells at {edges[0]:g} m; "
                "shorten the period or raise the fineness"
            )
        return boxes

    pool = ThreadPoolExecutor(threads)
    try:
        return list(tqdm(pool.map(images, rows), "images", len(rows), unit="row", disable=None))
    finally:
        pool.shutdown(cancel_futures=True)


def _spread_core(table: Table, images: list[Boxes], ranks: NDArray[np.int16]) -> None:
    """Add to the core all cells to which the core leads, until nothing changes."""
    done, added = np.zeros(len(ranks), np.uint8), 1
    while added > 0:
        added = 0
        for row, (boxes, start) in enumerate(images):
            fresh = spread_kernel(table, row, boxes, start, ranks, done)
            if fresh < 0:
                raise DiffbotError(
                    "no certificate: the errors may drive the robot out of the core and farther away than it starts"
                )
            added += fresh


def _rank_cells(table: Table, images: list[Boxes], ranks: NDArray[np.int16]) -> None:
    """Rank the cells row by row until nothing changes."""
    with tqdm(total=len(ranks), initial=int((ranks != UNRANKED).sum()), desc="ranks", unit="cell", disable=None) as bar:
        changed = 1
        while changed > 0:
            changed = 0
            for row, (boxes, start) in enumerate(images):
                fresh = rank_kernel(table, row, boxes, start, ranks)
                changed += fresh
                bar.update(fresh)
