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
from diffbot_lab.stability.adversary.observe import Observed, uniform_starts
from diffbot_lab.stability.adversary.search import CANDIDATES, STEPS, noise_of, score
from diffbot_lab.stability.interval.compiled import compile_bounds
from diffbot_lab.stability.tuned.check.cells import Cells, cells_of, rank_at
from diffbot_lab.stability.tuned.contract import PLANT, Contract
from diffbot_lab.stability.tuned.file import Certificate
from diffbot_sim.model.plant import PlantConfig, integrate

Array = NDArray[np.float64]

_RUNS_AT_A_TIME = 2000
_AFTERWARDS = 20
"""steps of a run after the certified time"""
_SIGMA_THETA = 0.01
"""[rad] what the estimate reports of its heading: known well enough for the goal"""


class TunedOpponent(NamedTuple):
    """The loop that the adversary plays against."""

    config: ControllerConfig
    contract: Contract
    plant: PlantConfig


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


class _Runs(NamedTuple):
    """What some runs with random noise did."""

    ends: Array
    counts: NDArray[np.int64]


def _some_runs(certificate: Certificate, cells: Cells, radius: float, many: int, seed: tuple[int, int]) -> _Runs:
    rng = np.random.default_rng(seed)
    runs = _Runs(np.empty((many, 3)), np.zeros((many, 4), np.int64))
    steps = certificate.claims.steps + _AFTERWARDS
    starts = uniform_starts(rng, many, radius)
    _runs_kernel(opponent_of_tuned(certificate), cells, starts, steps, rng, runs.ends, runs.counts)
    return runs


def observe_tuned(certificate: Certificate, steps: int, trajectories: int, seed: int) -> Observed:
    """Simulate with uniform noise within the contract.

    Args:
        certificate: to compare with.
        steps: at least so many in all runs together that begin in the core.
        trajectories: from starts within ``claims.start``.
        seed: of starts and noise; part i of the runs has the generator (seed, i).
    """
    claims, cells = certificate.claims, cells_of(certificate)
    sizes = [min(_RUNS_AT_A_TIME, trajectories - at) for at in range(0, trajectories, _RUNS_AT_A_TIME)]
    with ThreadPoolExecutor() as pool, tqdm(desc="trajectories", total=trajectories, unit="run", disable=None) as bar:
        jobs = [
            pool.submit(_some_runs, certificate, cells, claims.start, many, (seed, part))
            for part, many in enumerate(sizes)
        ]
        runs = [_counted(job.result(), bar) for job in jobs]
    counts = np.concatenate([one.counts for one in runs])
    ends = np.concatenate([one.ends for one in runs])
    from_core, left = int(counts[:, 0].sum()), int(counts[:, 1].sum())
    part = len(sizes)
    with tqdm(desc="steps from the core", total=steps, initial=from_core, unit="step", disable=None) as bar:
        while from_core < steps:
            found = _some_runs(certificate, cells, claims.radius, _RUNS_AT_A_TIME, (seed, part)).counts
            from_core, left, part = from_core + int(found[:, 0].sum()), left + int(found[:, 1].sum()), part + 1
            bar.update(int(found[:, 0].sum()))
    late, longest = int((counts[:, 3] > 0).sum()), int(counts[:, 2].max())
    return Observed(from_core, left, trajectories, late, longest, float(np.hypot(ends[:, 0], ends[:, 1]).max()), ends)


def _counted(runs: _Runs, bar: Any) -> _Runs:
    bar.update(len(runs.ends))
    return runs
