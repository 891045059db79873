"""Search for errors within the contract that keep the robot away from the goal. They are a lower bound of r*.

Two adversaries choose the errors for the law's own step:

- The greedy adversary knows the true state. In each step it tries a grid of errors, and chooses the errors whose next
  state has the highest score. The score is the distance plus a weighted sum of functions of alpha and beta, which do
  not change if both angles change their signs. The cross-entropy method searches for the best weights.
- The drift adversary acts in Omega_L. Its position error makes the robot drive forwards and backwards, so that the
  robot never rests, and its heading error shifts the robot to one side.

Better adversaries may exist.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from diffbot_control.law.regions import OMEGA_L, Switching, entering_radius, leaving_radius
from diffbot_control.law.steering import navigation_variables
from diffbot_control.law.switching import SwitchingMemory, new_memory
from diffbot_core.errors import DiffbotError
from diffbot_core.files import output_folder, write_json
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist
from diffbot_lab.stability.certificates import report
from diffbot_lab.stability.compiled import compile_bounds
from diffbot_lab.stability.file import Certificate, load_certificate
from diffbot_lab.stability.runs import ERRORS, ContractLoop, drive, loop_of, next_pose, sample, sigma_at

Array = NDArray[np.float64]

FEATURES = 9
STEPS, WARM_UP, WINDOW = 600, 150, 75
"""number of steps of a trajectory, of the first steps that do not count, and of a window. The adversary has to bring
the robot away from the goal in every window, because a distance that is reached only once is no counterexample"""
_CANDIDATES = 9 * 3 * 4
"""number of errors on the grid: 3 x 3 position errors, 3 heading errors, and 2 errors for each wheel"""
_GENERATIONS, _POPULATION, _ELITE = 40, 48, 0.15
"""number of generations of the search, number of trajectories in each generation, and share of the trajectories from
which the next generation is drawn"""
_START = 0.3
"""[m] bound of x and y of the starts of the greedy adversary"""
_ALONG = 0.6
"""share of the position error that the drift adversary uses along x, the direction in which the robot drives"""
_TURN_BACK = 0.3
"""share of the error along x at which the adversary reverses the robot. If it waited longer, the command would become
small enough to count as rest"""
_AHEAD = 0.03
"""[m] distance before the leaving radius from which the drift adversary reduces the measured lateral error"""
_DRIFT_STEPS = 200_000
_AFTERWARDS = 20
"""number of steps for which a random run continues after the certified time"""


class Attack(NamedTuple):
    """Result of the search for the greedy adversary's weights."""

    distance: float
    """[m] distance from the goal that the robot reaches in every window"""
    weights: Array
    """(FEATURES,) weights of the score"""


def score(pose: Pose, weights: Any) -> float:
    """Return the score of a state for the greedy adversary."""
    rho, alpha, beta = navigation_variables(pose)
    value: float = (
        rho
        + weights[0] * math.cos(alpha)
        + weights[1] * math.cos(2.0 * alpha)
        + weights[2] * math.cos(beta)
        + weights[3] * math.cos(2.0 * beta)
        + weights[4] * math.sin(alpha) * math.sin(beta)
        + weights[5] * math.sin(2.0 * alpha) * math.sin(beta)
        + weights[6] * math.cos(alpha) * math.cos(beta)
        + weights[7] * math.sin(alpha) * math.sin(2.0 * beta)
        + weights[8] * math.cos(4.0 * alpha)
    )
    return value


def _fill_path(loop: ContractLoop, start: Any, weights: Any, path: Any) -> None:
    """Fill ``path`` (steps, 3) with the poses under the greedy adversary.

    The position error of the base always points away from the goal.
    """
    pose, memory, errors = Pose(start[0], start[1], start[2]), new_memory(), np.empty(ERRORS)
    for step in range(len(path)):
        best, best_pose, best_memory = -math.inf, pose, memory
        rho = max(math.hypot(pose.x, pose.y), 1e-9)
        errors[5], errors[6] = pose.x / rho, pose.y / rho
        for candidate in range(_CANDIDATES):
            errors[0], errors[1] = candidate % 3 - 1.0, candidate // 3 % 3 - 1.0
            errors[2] = candidate // 9 % 3 - 1.0
            errors[3], errors[4] = 2.0 * (candidate // 27 % 2) - 1.0, 2.0 * (candidate // 54) - 1.0
            errors[7] = 0.5 * (errors[4] - errors[3])
            after, after_memory, _ = next_pose(loop, pose, memory, sigma_at(loop, pose), errors)
            value = score(after, weights)
            if value > best:
                best, best_pose, best_memory = value, after, after_memory
        pose, memory = best_pose, best_memory
        path[step, 0], path[step, 1], path[step, 2] = pose.x, pose.y, pose.theta


_path_kernel = compile_bounds(_fill_path)


def recurrent_distance(path: Array) -> float:
    """Return the distance [m] that poses (steps, 3) reach in every window of WINDOW steps after the warm-up."""
    rho = np.hypot(path[WARM_UP:, 0], path[WARM_UP:, 1])
    windows = np.lib.stride_tricks.sliding_window_view(rho, WINDOW)
    return float(windows.max(axis=1).min())


def search(
    loop: ContractLoop,
    seed: int,
    generations: int,
    population: int,
    each: Callable[[float], object],
) -> Attack:
    """Search for the weights with which the greedy adversary brings the robot farthest from the goal.

    Args:
        loop: law, contract and period.
        seed: seed of starts and weights.
        generations: number of generations.
        population: number of trajectories in each generation.
        each: called after each generation with the best distance so far.
    """

    def attack(start: Array, weights: Array) -> float:
        path = np.empty((STEPS, 3))
        _path_kernel(loop, start, weights, path)
        return recurrent_distance(path)

    rng = np.random.default_rng(seed)
    mean, deviation = np.zeros(FEATURES), np.full(FEATURES, 0.5)
    best = Attack(0.0, mean)
    attack(np.array([_START, 0.0, 0.0]), mean)  # compiles before the threads start
    with ThreadPoolExecutor() as pool:
        for _ in range(generations):
            weights = mean + deviation * rng.standard_normal((population, FEATURES))
            weights[0] = best.weights
            starts = rng.uniform(-1.0, 1.0, (population, 3)) * np.array([_START, _START, math.pi])
            distances = np.array(list(pool.map(attack, starts, weights)))
            order = np.argsort(-distances)
            elite = weights[order[: max(3, int(_ELITE * population))]]
            mean, deviation = elite.mean(axis=0), 0.8 * elite.std(axis=0) + 0.02
            if distances[order[0]] > best.distance:
                best = Attack(float(distances[order[0]]), weights[order[0]])
            each(best.distance)
    return best


def _drift(loop: ContractLoop, start: Pose, memory: SwitchingMemory, leaving: float, steps: int) -> float:
    """Drive the robot forwards and backwards in Omega_L, and return its largest distance [m] from the goal.

    Args:
        loop: law, contract and period.
        start: true pose in Omega_L, near the goal.
        memory: memory of the law at the start.
        leaving: [m] leaving radius of Omega_L.
        steps: largest number of steps.
    """
    pose, errors, turn_back = start, np.zeros(ERRORS), _TURN_BACK * _ALONG * loop.contract.eps_position
    farthest = math.hypot(start.x, start.y)
    for _ in range(steps):
        direction = math.copysign(1.0, memory.command.v)
        if direction * pose.x > turn_back:
            direction = -direction
        errors[0], errors[2] = -direction * _ALONG, -direction
        errors[1] = 0.0 if pose.y < leaving - _AHEAD else -math.sqrt(1.0 - _ALONG**2)
        pose, memory, _ = next_pose(loop, pose, memory, loop.contract.sigma_max, errors)
        if memory.switching.region != OMEGA_L:
            break
        farthest = max(farthest, math.hypot(pose.x, pose.y))
    return farthest


_drift_kernel = compile_bounds(_drift)


def drift_of(loop: ContractLoop) -> float:
    """Return the largest distance [m] of a drift that starts as far away as the law may enter Omega_L."""
    sigma, tolerance = loop.contract.sigma_max, loop.law.config.tolerance
    start = Pose(0.0, entering_radius(sigma, tolerance) + loop.contract.eps_position, 0.0)
    memory = new_memory()._replace(switching=Switching(OMEGA_L, 1, 0.0), command=Twist(0.1, 0.0))
    return float(_drift_kernel(loop, start, memory, leaving_radius(sigma, tolerance), _DRIFT_STEPS))


def run_adversary(path: Path, steps: int, trajectories: int, seed: int, out: Path) -> int:
    """Attack a certificate with the adversaries' errors and with random errors.

    Args:
        path: file of the certificate.
        steps: approximate number of steps with random errors from random memories.
        trajectories: number of runs with random errors that start anywhere within the certified distance.
        seed: seed of starts, errors and weights.
        out: folder of adversary.json.

    Raises:
        DiffbotError: if the certificate is refuted (after adversary.json is written), or the file cannot be written.
    """
    certificate = load_certificate(path)
    claims, plan, loop = certificate.claims, certificate.plan, loop_of(certificate)
    with output_folder(out):
        with tqdm(desc="adversary", total=_GENERATIONS, unit="generation", disable=None) as bar:
            attack = search(loop, seed, _GENERATIONS, _POPULATION, lambda _: bar.update())
        drift = drift_of(loop)
        distance = max(attack.distance, drift)
        observed = _observed(certificate, steps, trajectories, seed)
        result = {
            "certified": claims._asdict() | {"time": claims.steps * plan.period},
            "adversary": {
                "distance": distance,
                "again_and_again": attack.distance,
                "drift": drift,
                "weights": attack.weights.tolist(),
            },
            "certified_over_adversary": claims.radius / distance,
            "observed": observed,
            "plan": {**plan._asdict(), "contract": plan.contract._asdict()},
            "law": certificate.law,
            "seed": seed,
        }
        write_json(out / "adversary.json", result)
    print(report(certificate))
    print(json.dumps({key: result[key] for key in ("certified_over_adversary", "observed")}))
    print(f"An adversary brings the robot to {distance:.3f} m from the goal.\nResults in {out / 'adversary.json'}")
    left_core, late = observed["left_core"], observed["late"]
    if left_core or late or distance > claims.radius:
        raise DiffbotError(
            f"{path}: the certificate is refuted: {left_core} steps led out of the core, {late} runs reached the core "
            f"too late, and an adversary brought the robot to {distance:.3f} m (r* = {claims.radius:.3f} m)"
        )
    return 0


def _observed(certificate: Certificate, steps: int, trajectories: int, seed: int) -> dict[str, float]:
    """Return the counts of runs with random errors."""
    length = certificate.claims.steps + _AFTERWARDS
    runs, ends = drive(certificate, trajectories, certificate.claims.start, length, seed, any_memory=False)
    short = sample(certificate, steps, seed + 1)
    return {
        "steps_from_core": runs.from_core + short.from_core,
        "left_core": runs.left_core + short.left_core,
        "departures": runs.departures + short.departures,
        "trajectories": trajectories,
        "late": runs.broken + short.broken,
        "longest": runs.longest,
        "farthest": float(np.hypot(ends[:, 0], ends[:, 1]).max()),
    }
