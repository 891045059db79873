"""Bounds of r* from below: an adversary that chooses the noise, and how far from the goal it brings the robot back to.

The adversary knows the true state. In each step it tries corners, middles of sides and the middle of the noise box, and
takes the noise whose next state has the highest score: the distance plus a weighted sum of even functions of alpha and
beta. The weights are searched by the cross-entropy method. Every trajectory is one of the project's own law and plant,
so the distance that it comes back to again and again is reached indeed; another adversary may do better.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from diffbot_control.law.lyapunov_law import Gains, global_law, local_law
from diffbot_control.law.polar_coordinates import navigation_variables
from diffbot_control.law.regions import OMEGA_G, FixedRegionPolicy, fixed_region
from diffbot_core.geometry import Pose, wrap_angle
from diffbot_core.kinematics import Twist
from diffbot_lab.stability.interval.compiled import compile_bounds
from diffbot_lab.stability.paper.file import EXACT_ARC, Loop
from diffbot_sim.model.plant import integrate

Array = NDArray[np.float64]

FEATURES = 9
STEPS, WARM_UP, WINDOW = 600, 150, 75
"""Steps of a trajectory, those before it counts, and steps within which the robot has to be brought back."""
_ELITE, _SPREAD = 0.15, 0.5
_POSITIONS, _HEADINGS = 9, 3
_CANDIDATES = 4 * _POSITIONS * _HEADINGS


class Opponent(NamedTuple):
    """The loop that the adversary plays against."""

    gains: Gains
    policy: FixedRegionPolicy
    bounds: tuple[float, float, float, float, float]
    """of the errors of x, y [m], theta [rad], v [m/s], omega [rad/s]"""
    t_s: float
    exact_arc: bool


def opponent_of(loop: Loop) -> Opponent:
    """Return the loop of a certificate for the project's own functions."""
    return Opponent(
        Gains(loop.gamma, loop.k, loop.h, loop.k_2),
        FixedRegionPolicy(loop.eps_P, loop.eps_P_leave),
        (loop.eps_x, loop.eps_y, loop.eps_theta, loop.eps_v, loop.eps_omega),
        loop.t_s,
        loop.plant == EXACT_ARC,
    )


def next_state(opponent: Opponent, pose: Pose, region: int, noise: tuple[float, float, float, float, float]) -> Any:
    """Return pose and region after one step with this noise, in shares of the bounds."""
    bounds = opponent.bounds
    seen = Pose(
        pose.x + noise[0] * bounds[0], pose.y + noise[1] * bounds[1], wrap_angle(pose.theta + noise[2] * bounds[2])
    )
    navigation = navigation_variables(seen)
    region = fixed_region(region, navigation.rho, opponent.policy)
    if region == OMEGA_G:
        command = global_law(navigation, opponent.gains)
    else:
        command = local_law(navigation, seen.theta, opponent.gains)
    twist = Twist(command.v + noise[3] * bounds[3], command.omega + noise[4] * bounds[4])
    return integrate(pose, twist, opponent.t_s, opponent.exact_arc), region


def noise_of(candidate: int) -> tuple[float, float, float, float, float]:
    """Return the noise of a candidate: position errors on a 3 x 3 grid, headings -1, 0, 1, input noise +-1."""
    position, rest = candidate % _POSITIONS, candidate // _POSITIONS
    heading, inputs = rest % _HEADINGS, rest // _HEADINGS
    return position % 3 - 1.0, position // 3 - 1.0, heading - 1.0, 2.0 * (inputs % 2) - 1.0, 2.0 * (inputs // 2) - 1.0


def score(pose: Pose, weights: Any) -> float:
    """Return how good a state is for the adversary."""
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


def _play(opponent: Opponent, start: Any, weights: Any, path: Any) -> None:
    """Fill ``path`` (steps, 3) with the poses of the greedy adversary."""
    pose, region = Pose(start[0], start[1], start[2]), OMEGA_G
    for step in range(len(path)):
        best, best_pose, best_region = -math.inf, pose, region
        for candidate in range(_CANDIDATES):
            after, after_region = next_state(opponent, pose, region, noise_of(candidate))
            value = score(after, weights)
            if value > best:
                best, best_pose, best_region = value, after, after_region
        pose, region = best_pose, best_region
        path[step, 0], path[step, 1], path[step, 2] = pose.x, pose.y, pose.theta


_play_kernel = compile_bounds(_play)


def play(opponent: Opponent, start: Array, weights: Array, steps: int = STEPS) -> Array:
    """Return the poses (steps, 3) under the adversary with these weights, from a start x, y [m], theta [rad]."""
    path: Array = np.empty((steps, 3))
    _play_kernel(opponent, start, weights, path)
    return path


def recurrent_distance(path: Array) -> float:
    """Return the distance [m] that is reached in every window of WINDOW steps after the warm-up."""
    rho = np.hypot(path[WARM_UP:, 0], path[WARM_UP:, 1])
    windows = np.lib.stride_tricks.sliding_window_view(rho, WINDOW)
    return float(windows.max(axis=1).min())


class Attack(NamedTuple):
    """The best adversary that was found."""

    distance: float
    """[m]"""
    weights: Array
    """(FEATURES,)"""
    path: Array
    """(steps, 3) poses"""


def search(
    loop: Loop,
    seed: int,
    generations: int = 40,
    population: int = 48,
    threads: int | None = None,
    each: Callable[[float], None] | None = None,
) -> Attack:
    """Search the weights; ``each`` is called after each generation with the best distance so far."""
    opponent, rng = opponent_of(loop), np.random.default_rng(seed)
    mean, spread = np.zeros(FEATURES), np.full(FEATURES, _SPREAD)
    best = Attack(0.0, mean, np.zeros((STEPS, 3)))
    _play_kernel(opponent, np.zeros(3), mean, np.empty((1, 3)))  # compiles before the threads start
    with ThreadPoolExecutor(threads) as pool:
        for _ in range(generations):
            weights = mean + spread * rng.standard_normal((population, FEATURES))
            weights[0] = best.weights
            starts = rng.uniform(-1.0, 1.0, (population, 3)) * np.array([0.8, 0.8, math.pi])
            paths = list(pool.map(lambda one: play(opponent, *one), zip(starts, weights, strict=True)))
            distances = np.array([recurrent_distance(path) for path in paths])
            order = np.argsort(-distances)
            elite = weights[order[: max(3, int(_ELITE * population))]]
            mean, spread = elite.mean(axis=0), 0.8 * elite.std(axis=0) + 0.02
            if distances[order[0]] > best.distance:
                best = Attack(float(distances[order[0]]), weights[order[0]], paths[order[0]])
            if each is not None:
                each(best.distance)
    return best
