"""Checks a certificate of the law with braking profiles again.

``verify`` works out the cells, the bounds of Omega_L and the images anew from the configuration in the file, and
compares ranks; how the ranks were found does not matter to it. It shares the image of a cell with ``certify``.
``sample`` does not: it takes random states and noise, and the law, the regions and the plant of the robot itself.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from tqdm import tqdm

from diffbot_control.law.polar_coordinates import Navigation
from diffbot_control.law.speed_profile import ProfileGains
from diffbot_control.law.steering import FRONT, drive_and_steer
from diffbot_core.data_sheet import DataSheet
from diffbot_core.errors import DiffbotError
from diffbot_core.geometry import Pose, wrap_angle
from diffbot_core.kinematics import WheelSpeeds, body_twist, wheel_speeds
from diffbot_lab.stability.interval.compiled import compile_bounds
from diffbot_lab.stability.rank.cells import row_of
from diffbot_lab.stability.rank.ranking import UNRANKED
from diffbot_lab.stability.tuned.certify import (
    PLANT,
    Certificate,
    boxes_of_row,
    core_radius,
    seed_rows,
    steps_from,
    table_of,
    tuned_loop,
)
from diffbot_lab.stability.tuned.near import near_bounds
from diffbot_lab.stability.tuned.table import CORE, check_kernel, columns_of, kept_index
from diffbot_sim.model.plant import integrate


class Claims(NamedTuple):
    """What is proved."""

    radius: float
    """[m] r*: once in the core, the robot stays within this distance"""
    start: float
    """[m] from every state within this distance ..."""
    steps: int
    """... the robot is in the core after so many steps at most"""
    cells: int


class Sampled(NamedTuple):
    """Random steps against a certificate."""

    steps: int
    broken: int
    """steps that led to a rank that is not smaller, or out of the core"""


def verify(certificate: Certificate) -> Claims:
    """Check every cell and return what is proved.

    Raises:
        DiffbotError: naming the first thing that is not.
    """
    plan, table, ranks = certificate.plan, certificate.table, certificate.ranks
    loop = tuned_loop(certificate.config, plan.contract)
    near = near_bounds(loop, certificate.config, plan.contract.eps_xy, plan.contract.sigma_max)
    expected, seed = table_of(loop, near, plan)
    if not np.array_equal(expected.rho, table.rho):
        raise DiffbotError("not verified: the cells are not those of the configuration")
    if (ranks[: table.start[seed_rows(table, seed)]] != CORE).any() or (ranks < UNRANKED).any():
        raise DiffbotError(f"not verified: not all within {seed:.4g} m, where Omega_L may lead to, is in the core")
    for row in tqdm(range(len(table.rho) - 1), desc="verify", unit="row", disable=None):
        boxes, start = boxes_of_row(loop, table, row)
        broken = check_kernel(table, row, boxes, start, ranks)
        if broken:
            raise DiffbotError(
                f"not verified: {broken} cells from rho {table.rho[row]:.4f} to {table.rho[row + 1]:.4f} m may lead to "
                "a rank that is not smaller, or out of the core"
            )
    return Claims(core_radius(certificate), plan.to, steps_from(certificate, plan.to), int((ranks != UNRANKED).sum()))


def random_steps(
    table: Any,
    ranks: Any,
    gains: ProfileGains,
    sheet: DataSheet,
    contract: Any,
    plant: Any,
    draws: Any,
) -> int:
    """Do a step of Omega_G from each of random states, with the robot's own law; count the ones that break a rank.

    Args:
        table: of the cells.
        ranks: of the cells.
        gains: of the law.
        sheet: data sheet.
        contract: of the estimate.
        plant: of the robot.
        draws: (n, 9) in [-1, 1]: distance, alpha, beta; errors of x, y, theta and sigma; errors of the wheels.
    """
    broken = 0
    for one in draws:
        rho = table.rho[0] + (table.rho[-1] - table.rho[0]) * (0.5 * one[0] + 0.5) ** 4
        alpha, beta = math.pi * one[1], math.pi * one[2]
        before = rank_at(table, ranks, rho, alpha, beta)
        if before == UNRANKED:
            continue
        pose = Pose(-rho * math.cos(beta), -rho * math.sin(beta), wrap_angle(beta - alpha))
        after = _step_of_robot(pose, gains, sheet, contract, plant, one)
        beta = math.atan2(-after.y, -after.x)
        rank = rank_at(table, ranks, math.hypot(after.x, after.y), wrap_angle(beta - after.theta), beta)
        if rank == UNRANKED or rank > max(before - 1, CORE):
            broken += 1
    return broken


def _step_of_robot(pose: Pose, gains: ProfileGains, sheet: DataSheet, contract: Any, plant: Any, one: Any) -> Pose:
    """Return the true pose after a step of Omega_G with the front leading; see :func:`random_steps`."""
    dx, dy = -pose.x - contract.eps_xy * one[3], -pose.y - contract.eps_xy * one[4]
    seen = math.atan2(dy, dx)
    bearing = wrap_angle(seen - pose.theta - contract.eps_theta * one[5])
    sigma = contract.sigma_max * (0.5 * one[6] + 0.5)
    command = drive_and_steer(Navigation(math.hypot(dx, dy), bearing, seen), sigma, FRONT, gains, sheet)
    wheels = wheel_speeds(command, sheet.wheels)
    left, right = wheels.left * (1.0 + plant.drive_noise * one[7]), wheels.right * (1.0 + plant.drive_noise * one[8])
    moved = body_twist(WheelSpeeds(left, right), sheet.wheels)
    return integrate(pose, moved, plant.sampling_time, plant.exact_arc)


def rank_at(table: Any, ranks: Any, rho: float, alpha: float, beta: float) -> int:
    """Rank of a state: CORE inside, UNRANKED beyond the cells."""
    row = row_of(table.rho, rho)
    if row < 0:
        return CORE
    if row >= len(table.rho) - 1:
        return UNRANKED
    i, _ = columns_of(alpha, alpha, table.alphas[row])
    j, _ = columns_of(beta, beta, table.betas[row])
    return int(ranks[kept_index(table, row, i, j)])


_random_kernel = compile_bounds(random_steps)


def sample(certificate: Certificate, steps: int, seed: int) -> Sampled:
    """Compare random steps with the ranks; half of the draws of noise are at its bounds.

    Args:
        certificate: to compare with.
        steps: how many.
        seed: of states and noise.
    """
    config, broken, left = certificate.config, 0, steps
    gains = config.profile_gains
    rng = np.random.default_rng(seed)
    while left > 0:
        number = min(left, 1_000_000)
        draws = rng.uniform(-1.0, 1.0, (number, 9))
        extreme = draws[: number // 2, 3:]
        extreme[:] = np.sign(extreme)
        broken += _random_kernel(
            certificate.table,
            certificate.ranks,
            gains,
            config.data_sheet,
            certificate.plan.contract,
            PLANT,
            draws,
        )
        left -= number
    return Sampled(steps, broken)
