"""Makes a certificate of the law with braking profiles under a contract of the estimate: core and ranks.

From every state whose rank is n, of whatever course and memory, the robot is in the core after at most n steps, and
stays.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from diffbot_control.law.configuration import ControllerConfig
from diffbot_control.law.controller import SwitchingLaw
from diffbot_control.law.speed_profile import vagueness_of
from diffbot_core.data_sheet import rim_speed
from diffbot_core.errors import DiffbotError, InvalidValueError
from diffbot_lab.stability.file import MAX_CELLS, Certificate, Claims
from diffbot_lab.stability.maker.images import number_of_slices
from diffbot_lab.stability.maker.law import TunedLoop, approach
from diffbot_lab.stability.maker.near import longest_step, near_bounds
from diffbot_lab.stability.maker.table import (
    CORE,
    UNRANKED,
    Band,
    Boxes,
    Table,
    cell_of,
    fill_kernel,
    make_table,
    rank_kernel,
    spread_kernel,
    with_rows_split,
)
from diffbot_lab.stability.plan import Plan, check_plan, requesting
from diffbot_sim.compiled.jit import law_version

_FARTHER = 1.02
"""step of the search for a distance that Omega_L does not outlast: the bounds grow with it, but more slowly"""
_AT_ONCE = 1.25
"""rows up to this multiple of the innermost one without a rank are halved at a time"""
_NARROWEST = 0.01
"""share of the longest step: a row that is narrower is not halved"""
_MOST_CELLS = 12_000_000
"""some 5 GB"""


def tuned_loop(config: ControllerConfig, plan: Plan) -> TunedLoop:
    """Collect the numbers of the loop of a law as it requests."""
    sheet, contract = config.data_sheet, plan.contract
    gains = config.profile_gains
    vagueness = vagueness_of(contract.sigma_max, gains, config.tolerance.xy_goal_tolerance)
    return TunedLoop(
        gains.brake,
        gains.react,
        gains.react * vagueness * vagueness if vagueness > 1.0 else gains.react,
        gains.bearing_weight,
        gains.turn_brake,
        gains.turn_react,
        sheet.v_max,
        sheet.omega_max,
        rim_speed(sheet),
        0.5 * sheet.wheels.wheel_separation,
        contract.eps_position,
        contract.eps_theta,
        contract.wheel_error,
        contract.eps_v,
        contract.eps_omega,
        plan.period,
    )


def core_radius(table: Table, ranks: NDArray[np.int16]) -> float:
    """r* [m]: the robot stays within this distance of the goal once it is in the core."""
    farthest = table.rho[0]
    for row in range(len(table.rho) - 1):
        if (ranks[table.start[row] : table.start[row + 1]] == CORE).any():
            farthest = table.rho[row + 1]
    return float(farthest)


def steps_from(table: Table, ranks: NDArray[np.int16], distance: float) -> int:
    """Return after how many steps at most the robot is in the core, from any state within ``distance`` [m].

    Raises:
        DiffbotError: if there are states that are not certified.
    """
    ranks = ranks[: table.start[int(np.searchsorted(table.rho, distance))]]
    if (ranks == UNRANKED).any():
        bad = int(np.argmax(ranks == UNRANKED))
        row = int(np.searchsorted(table.start, bad, side="right")) - 1
        share = float((ranks == UNRANKED).mean())
        raise DiffbotError(
            f"no certificate: {100.0 * share:.3g} % of the cells, from {table.rho[row]:.4g} m, have no rank: "
            "the errors may cancel the robot's progress there"
        )
    return int(ranks.max(initial=0))


def holding_radius(law: ControllerConfig, plan: Plan) -> float:
    """True distance [m] at which Omega_L ends at the latest, by the contract of a robot within that distance.

    Raises:
        DiffbotError: if there is none where the robot starts: the bounds of the estimate grow too fast.
    """
    within = 0.0
    while within < plan.to:
        here = plan.at(within)
        holding = near_bounds(tuned_loop(law, here), law, here.contract.sigma_max).holding
        if holding <= within or here == plan:
            return holding
        within = holding * _FARTHER
    raise DiffbotError(f"no certificate: Omega_L may last as far as {plan.to:g} m, where the robot starts")


def table_of(loop: TunedLoop, near: float, plan: Plan) -> tuple[Table, float]:
    """Return the cells of a plan, and the radius [m] of the core's seed: every state within it may recur.

    Args:
        loop: by the contract of a robot within the seed.
        near: [m] at which Omega_L ends at the latest.
        plan: contract, start and cells.
    """
    seed = near + plan.margin
    inside = seed - 0.1
    # No command in Omega_G or Omega_L leads from inside beyond the seed.
    for _ in range(20):
        far = inside + loop.eps_position
        speed = approach(loop, far, far)[1]
        if inside + longest_step(loop, speed) < seed:
            break
        inside -= 0.01
    if not inside > loop.eps_position or not inside + longest_step(loop, speed) < seed:
        raise DiffbotError("no certificate: Omega_L is too small for the error of the position")
    fine = plan.fineness
    even = 2 * math.ceil(150 * fine), 2 * math.ceil(48 * fine)
    nearest, near_goal = seed + 0.16, max(0.7, seed + 0.16)
    bands = (
        Band(nearest, 0.006 / fine, 0.01, *even, 0.06 / fine),
        Band(near_goal, 0.006, 0.01, 300, 96, 0.06),
        Band(max(1.1, near_goal), 0.01, 0.01, 200, 48, 0.1),
        Band(plan.to + 0.3, 0.01, 0.01, 160, 32, 0.1),
    )
    table = make_table(inside, bands)
    if table.start[-1] > MAX_CELLS:
        raise InvalidValueError("fineness", plan.fineness, f"less: this makes {table.start[-1]} cells")
    return table, seed


def boxes_of_row(loop: TunedLoop, table: Table, row: int) -> Boxes:
    """Work out the images of a row's cells.

    Raises:
        DiffbotError: if a cell has no bounded image.
    """
    cells = int(table.start[row + 1] - table.start[row])
    slices = number_of_slices(loop, cell_of(table, row, 0), float(table.slices[row])) + 1
    work = np.empty((9 * slices, 6))
    boxes = np.empty((cells * 9 * slices, 6), np.float32)
    counts = np.zeros(cells, np.int64)
    number = fill_kernel(loop, table, row, work, boxes, counts)
    if number < 0:
        raise DiffbotError(f"no certificate: cells at {table.rho[row]:g} m are too large for a bounded image")
    return Boxes(boxes[:number].copy(), np.concatenate(([0], np.cumsum(counts))))


def certify(config: ControllerConfig, plan: Plan, threads: int | None = None) -> Certificate:
    """Work out core and ranks.

    Args:
        config: of the controller.
        plan: contract, start and cells.
        threads: for the images, at a time; None: one per core.

    Raises:
        DiffbotError: if the configuration is not covered, or there is no certificate.
    """
    check_plan(plan)
    law = requesting(config, plan)
    near = holding_radius(law, plan)
    table, seed = table_of(tuned_loop(law, plan.at(near + plan.margin)), near, plan)

    def images_of(table: Table, rows: Iterable[int]) -> list[Boxes]:
        return _images_of_rows(lambda rho: tuned_loop(law, plan.at(rho)), table, list(rows), threads)

    images = images_of(table, range(len(table.rho) - 1))
    ranks = np.full(int(table.start[-1]), UNRANKED, np.int16)
    ranks[: table.start[seed_rows(table, seed)]] = CORE
    _spread(table, images, ranks)
    _rank(table, images, ranks)
    while (split := rows_to_split(table, ranks, plan.to, plan.period * law.data_sheet.v_max)).any():
        finer, old = with_rows_split(table, split)
        # What has a rank keeps it: a half leads where the whole does.
        ranks = np.concatenate([ranks[table.start[row] : table.start[row + 1]] for row in old])
        table, fresh = finer, np.flatnonzero(split[old])
        images = [images[row] for row in old]
        for row, found in zip(fresh, images_of(table, fresh), strict=True):
            images[row] = found
        _rank(table, images, ranks)
    claims = Claims(core_radius(table, ranks), float(plan.to), steps_from(table, ranks, plan.to), seed)
    return Certificate(plan, config, table.rho, table.alphas, table.betas, ranks, claims, law_version(SwitchingLaw))


def rows_to_split(table: Table, ranks: NDArray[np.int16], distance: float, longest: float) -> NDArray[np.bool_]:
    """Return the rows (rows,) that are to be halved: the innermost ones without a rank.

    What lies farther out often has no rank only since it leads there. A row is not made narrower than ``_NARROWEST``.

    Args:
        table: of the cells.
        ranks: of the cells.
        distance: [m] up to which ranks are wanted.
        longest: [m] step.
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


def _images_of_rows(
    loop_at: Callable[[float], TunedLoop], table: Table, rows: list[int], threads: int | None
) -> list[Boxes]:
    with (
        ThreadPoolExecutor(threads) as pool,
        tqdm(total=len(rows), desc="images", unit="row", disable=None) as bar,
    ):
        found = []
        try:
            for one in pool.map(lambda row: boxes_of_row(loop_at(float(table.rho[row + 1])), table, row), rows):
                found.append(one)
                bar.update()
        except KeyboardInterrupt:
            pool.shutdown(cancel_futures=True)
            raise
    return found


def _rank(table: Table, images: list[Boxes], ranks: NDArray[np.int16]) -> None:
    """Rank what can be ranked, row by row, until nothing changes."""
    with tqdm(total=len(ranks), initial=int((ranks != UNRANKED).sum()), desc="ranks", unit="cell", disable=None) as bar:
        changed = 1
        while changed > 0:
            changed = 0
            for row, (boxes, start) in enumerate(images):
                fresh = rank_kernel(table, row, boxes, start, ranks)
                changed += fresh
                bar.update(fresh)


def seed_rows(table: Table, seed: float) -> int:
    """Return how many rows begin within the seed of the core [m]."""
    return int(np.searchsorted(table.rho, seed, side="right")) if seed > table.rho[0] else 0


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
