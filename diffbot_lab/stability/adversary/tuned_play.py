"""The default law against its certificate: noise within the contract, chosen by an adversary or at random.

Estimates are the true pose with errors within the contract; law, regions, finish and plant are those of the robot.
"""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from diffbot_control.law.braking_step import braking_step
from diffbot_control.law.configuration import ControllerConfig, ControllerMemory, new_memory
from diffbot_control.law.steering import BACK
from diffbot_core.geometry import Pose, wrap_angle
from diffbot_core.kinematics import WheelSpeeds, body_twist, wheel_speeds
from diffbot_core.uncertainty import Estimate, Uncertainty
from diffbot_lab.stability.adversary.search import CANDIDATES, STEPS, noise_of, score
from diffbot_lab.stability.interval.compiled import compile_bounds
from diffbot_lab.stability.tuned.check.cells import Cells, cells_of, rank_at
from diffbot_lab.stability.tuned.contract import PLANT, Contract
from diffbot_lab.stability.tuned.file import Certificate
from diffbot_sim.model.plant import PlantConfig, integrate

Array = NDArray[np.float64]

_RUNS_AT_A_TIME = 2000
_SIGMA_THETA = 0.01
"""[rad] what the estimate reports of its heading; the law's command does not depend on it"""


class TunedOpponent(NamedTuple):
    """The loop that the adversary plays against."""

    config: ControllerConfig
    contract: Contract
    plant: PlantConfig


class TunedObserved(NamedTuple):
    """What random noise within the contract did."""

    steps_from_core: int
    """steps that began in the core ..."""
    left_core: int
    """... and ended outside of it"""
    trajectories: int
    """from all over the start ..."""
    late: int
    """... and of these, the ones with a step whose rank did not fall"""
    longest: int
    """steps until a trajectory was in the core for good"""
    farthest: float
    """[m] distance from the goal in the last tenth of the trajectories"""
    cloud: Array
    """(n, 3) poses at the end of trajectories"""


def next_tuned(opponent: TunedOpponent, pose: Pose, memory: ControllerMemory, sigma: float, noise: Any) -> Any:
    """Return pose and memory after one step.

    Args:
        opponent: law, contract and plant.
        pose: true one; the goal is the origin.
        memory: of the controller.
        sigma: [m] that the estimate reports.
        noise: errors of x, y, theta, and of the left and right wheel, in shares of their bounds.
    """
    config, contract, plant = opponent
    # The corners of the square are drawn into the disc.
    share = contract.eps_position / max(1.0, math.hypot(noise[0], noise[1]))
    seen = Pose(
        pose.x + share * noise[0],
        pose.y + share * noise[1],
        wrap_angle(pose.theta + contract.eps_theta * noise[2]),
    )
    estimate = Estimate(seen, Uncertainty(sigma, _SIGMA_THETA))
    memory, command, _ = braking_step(memory, estimate, Pose(0.0, 0.0, 0.0), plant.sampling_time, config)
    wheels = wheel_speeds(command, config.data_sheet.wheels)
    left, right = (
        wheels.left * (1.0 + plant.drive_noise * noise[3]),
        wheels.right * (1.0 + plant.drive_noise * noise[4]),
    )
    moved = body_twist(WheelSpeeds(left, right), config.data_sheet.wheels)
    return integrate(pose, moved, plant.sampling_time, plant.exact_arc), memory


def _play(opponent: TunedOpponent, start: Any, weights: Any, path: Any) -> None:
    """Fill ``path`` (steps, 3) with the poses of the greedy adversary."""
    pose, memory = Pose(start[0], start[1], start[2]), new_memory()
    for step in range(len(path)):
        best, best_pose, best_memory = -math.inf, pose, memory
        for candidate in range(CANDIDATES):
            noise = noise_of(candidate)
            after, after_memory = next_tuned(opponent, pose, memory, opponent.contract.sigma_max, noise)
            value = score(after, weights)
            if value > best:
                best, best_pose, best_memory = value, after, after_memory
        pose, memory = best_pose, best_memory
        path[step, 0], path[step, 1], path[step, 2] = pose.x, pose.y, pose.theta


def _runs(opponent: TunedOpponent, cells: Cells, starts: Any, steps: int, rng: Any, ends: Any, counts: Any) -> None:
    """Drive from each start with uniform noise.

    Args:
        opponent: law, contract and plant.
        cells: with ranks.
        starts: (n, 3) poses.
        steps: of each run.
        rng: random generator.
        ends: (n, 3) for the last poses.
        counts: (n, 4) for the steps from the core, those out of it, the steps until the core for good, and those whose
            rank did not fall.
    """
    for index in range(len(starts)):
        pose, memory = Pose(starts[index, 0], starts[index, 1], starts[index, 2]), new_memory()
        for step in range(steps):
            sigma = opponent.contract.sigma_max * rng.random()
            noise = (
                2.0 * rng.random() - 1.0,
                2.0 * rng.random() - 1.0,
                2.0 * rng.random() - 1.0,
                2.0 * rng.random() - 1.0,
                2.0 * rng.random() - 1.0,
            )
            after, memory = next_tuned(opponent, pose, memory, sigma, noise)
            before_rank = _rank(cells, pose, memory.course.leading == BACK)
            rank = _rank(cells, after, memory.course.leading == BACK)
            if before_rank == 0:
                counts[index, 0] += 1
                counts[index, 1] += rank > 0
            if rank > 0:
                counts[index, 2] = step + 1
            if rank > max(before_rank - 1, 0):
                counts[index, 3] += 1
            pose = after
        ends[index, 0], ends[index, 1], ends[index, 2] = pose.x, pose.y, pose.theta


def _rank(cells: Cells, pose: Pose, back: bool) -> int:
    """Rank of a pose with the front or the back leading."""
    turned = math.pi if back else 0.0
    beta = math.atan2(-pose.y, -pose.x)
    return rank_at(cells, math.hypot(pose.x, pose.y), wrap_angle(beta - pose.theta - turned), wrap_angle(beta - turned))


_play_kernel = compile_bounds(_play)
_runs_kernel = compile_bounds(_runs)


def play_tuned(opponent: TunedOpponent, start: Array, weights: Array, steps: int = STEPS) -> Array:
    """Return the poses (steps, 3) under the adversary with these weights, from a start x, y [m], theta [rad]."""
    path: Array = np.empty((steps, 3))
    _play_kernel(opponent, start, weights, path)
    return path


def opponent_of_tuned(certificate: Certificate) -> TunedOpponent:
    """Return the loop of a certificate."""
    return TunedOpponent(certificate.config, certificate.plan.contract, PLANT)


def observe_tuned(certificate: Certificate, steps: int, trajectories: int, seed: int) -> TunedObserved:
    """Simulate with uniform noise within the contract.

    Args:
        certificate: to compare with.
        steps: at least so many in all runs together that begin in the core.
        trajectories: from starts within ``claims.start``.
        seed: of starts and noise; part i of the runs has the generator (seed, i).
    """
    claims, cells = certificate.claims, cells_of(certificate)
    opponent, length = opponent_of_tuned(certificate), claims.steps + 20
    ends, counts = [], np.zeros(4, np.int64)
    late = longest = 0

    def part(number: int, many: int, radius: float) -> tuple[Array, NDArray[np.int64]]:
        rng = np.random.default_rng((seed, number))
        rho, angle = radius * np.sqrt(rng.random(many)), rng.uniform(-math.pi, math.pi, many)
        heading = rng.uniform(-math.pi, math.pi, many)
        starts = np.stack([rho * np.cos(angle), rho * np.sin(angle), heading], axis=1)
        last, found = np.empty((many, 3)), np.zeros((many, 4), np.int64)
        _runs_kernel(opponent, cells, starts, length, rng, last, found)
        return last, found

    parts = [(claims.start, min(_RUNS_AT_A_TIME, trajectories - at)) for at in range(0, trajectories, _RUNS_AT_A_TIME)]
    with ThreadPoolExecutor() as pool, tqdm(desc="trajectories", total=trajectories, unit="run", disable=None) as bar:
        jobs = [pool.submit(part, number, many, radius) for number, (radius, many) in enumerate(parts)]
        for job in jobs:
            last, found = job.result()
            counts += found.sum(axis=0)
            late += int((found[:, 3] > 0).sum())
            longest = max(longest, int(found[:, 2].max()))
            ends.append(last)
            bar.update(len(last))
    number = len(parts)
    with tqdm(desc="steps from the core", total=steps, unit="step", unit_scale=True, disable=None) as bar:
        while counts[0] < steps:
            last, found = part(number, _RUNS_AT_A_TIME, claims.radius)
            counts += found.sum(axis=0)
            bar.update(int(found[:, 0].sum()))
            number += 1
    cloud = np.concatenate(ends)
    farthest = float(np.hypot(cloud[:, 0], cloud[:, 1]).max())
    return TunedObserved(int(counts[0]), int(counts[1]), trajectories, late, longest, farthest, cloud)
