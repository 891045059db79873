"""Random steps of the robot's own law, regions and plant against the ranks of a certificate."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from diffbot_control.law.polar_coordinates import Navigation
from diffbot_control.law.speed_profile import ProfileGains, vagueness_of
from diffbot_control.law.steering import FRONT, drive_and_steer
from diffbot_core.data_sheet import DataSheet
from diffbot_core.geometry import Pose, wrap_angle
from diffbot_core.kinematics import WheelSpeeds, body_twist, wheel_speeds
from diffbot_lab.stability.interval.compiled import compile_bounds
from diffbot_lab.stability.tuned.check.cells import TOO_HIGH, Cells, cells_of, rank_at
from diffbot_lab.stability.tuned.contract import PLANT
from diffbot_lab.stability.tuned.file import Certificate
from diffbot_sim.model.plant import integrate


class Sampled(NamedTuple):
    """Random steps against a certificate."""

    steps: int
    broken: int
    """steps that led to a rank that is not smaller, or out of the core"""


def random_steps(
    cells: Cells,
    gains: ProfileGains,
    xy_goal_tolerance: float,
    sheet: DataSheet,
    contract: Any,
    plant: Any,
    draws: Any,
) -> int:
    """Do a step of Omega_G from each of random states, with the robot's own law; count the ones that break a rank.

    Args:
        cells: with ranks.
        gains: of the law.
        xy_goal_tolerance: [m] of the goal.
        sheet: data sheet.
        contract: of the estimate.
        plant: of the robot.
        draws: (n, 9) in [-1, 1]: distance, alpha, beta; errors of x, y, theta and sigma; errors of the wheels.
    """
    broken = 0
    for one in draws:
        rho = cells.rho[0] + (cells.rho[-1] - cells.rho[0]) * (0.5 * one[0] + 0.5) ** 4
        alpha, beta = math.pi * one[1], math.pi * one[2]
        before = rank_at(cells, rho, alpha, beta)
        if before == TOO_HIGH:
            continue
        pose = Pose(-rho * math.cos(beta), -rho * math.sin(beta), wrap_angle(beta - alpha))
        sigma = contract.sigma_max * (0.5 * one[6] + 0.5)
        vagueness = vagueness_of(sigma, gains, xy_goal_tolerance)
        after = _step_of_robot(pose, vagueness, gains, sheet, contract, plant, one)
        beta = math.atan2(-after.y, -after.x)
        rank = rank_at(cells, math.hypot(after.x, after.y), wrap_angle(beta - after.theta), beta)
        if rank > max(before - 1, 0):
            broken += 1
    return broken


def _step_of_robot(
    pose: Pose, vagueness: float, gains: ProfileGains, sheet: DataSheet, contract: Any, plant: Any, one: Any
) -> Pose:
    """Return the true pose after a step of Omega_G with the front leading; see :func:`random_steps`."""
    share = contract.eps_position / max(1.0, math.hypot(one[3], one[4]))
    dx, dy = -pose.x - share * one[3], -pose.y - share * one[4]
    seen = math.atan2(dy, dx)
    bearing = wrap_angle(seen - pose.theta - contract.eps_theta * one[5])
    command = drive_and_steer(Navigation(math.hypot(dx, dy), bearing, seen), vagueness, FRONT, gains, sheet)
    wheels = wheel_speeds(command, sheet.wheels)
    left, right = wheels.left * (1.0 + plant.drive_noise * one[7]), wheels.right * (1.0 + plant.drive_noise * one[8])
    moved = body_twist(WheelSpeeds(left, right), sheet.wheels)
    return integrate(pose, moved, plant.sampling_time, plant.exact_arc)


_random_kernel = compile_bounds(random_steps)


def sample(certificate: Certificate, steps: int, seed: int) -> Sampled:
    """Compare random steps with the ranks; half of the draws of noise are at its bounds.

    Args:
        certificate: to compare with.
        steps: how many.
        seed: of states and noise.
    """
    config, cells, broken, left = certificate.config, cells_of(certificate), 0, steps
    gains = config.profile_gains
    rng = np.random.default_rng(seed)
    while left > 0:
        number = min(left, 1_000_000)
        draws = rng.uniform(-1.0, 1.0, (number, 9))
        extreme = draws[: number // 2, 3:]
        extreme[:] = np.sign(extreme)
        broken += _random_kernel(
            cells,
            gains,
            config.tolerance.xy_goal_tolerance,
            config.data_sheet,
            certificate.plan.contract,
            PLANT,
            draws,
        )
        left -= number
    return Sampled(steps, broken)
