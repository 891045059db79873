"""Bounds of r* from below: an adversary that chooses the noise, and how far from the goal it brings the robot back to.

The adversary knows the true state. In each step it tries corners, middles of sides and the middle of the noise box, and
takes the noise whose next state has the highest score: the distance plus a weighted sum of even functions of alpha and
beta. The weights are searched by the cross-entropy method. Every trajectory is one of the project's own law and plant
(play.py), so the distance that it comes back to again and again is reached indeed; another adversary may do better.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from diffbot_control.law.polar_coordinates import navigation_variables
from diffbot_core.geometry import Pose

Array = NDArray[np.float64]

FEATURES = 9
STEPS, WARM_UP, WINDOW = 600, 150, 75
"""Steps of a trajectory, those before it counts, and steps within which the robot has to be brought back."""
_ELITE, _SPREAD = 0.15, 0.5
_POSITIONS, _HEADINGS = 9, 3
CANDIDATES = 4 * _POSITIONS * _HEADINGS
Play = Callable[[Array, Array], Array]
"""From a start x, y [m], theta [rad] and weights (FEATURES,) to the poses (STEPS, 3)."""


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
    play: Play,
    spread: float,
    seed: int,
    generations: int = 40,
    population: int = 48,
    threads: int | None = None,
    each: Callable[[float], None] | None = None,
) -> Attack:
    """Search the weights.

    Args:
        play: a trajectory against the loop.
        spread: [m] starts are within it, in x and in y.
        seed: of starts and weights.
        generations: of the search.
        population: trajectories in each of them.
        threads: at a time; None: one per core.
        each: called after each generation with the best distance so far.
    """
    rng = np.random.default_rng(seed)
    mean, deviation = np.zeros(FEATURES), np.full(FEATURES, _SPREAD)
    best = Attack(0.0, mean, np.zeros((STEPS, 3)))
    play(np.array([spread, 0.0, 0.0]), mean)  # compiles before the threads start
    with ThreadPoolExecutor(threads) as pool:
        for _ in range(generations):
            weights = mean + deviation * rng.standard_normal((population, FEATURES))
            weights[0] = best.weights
            starts = rng.uniform(-1.0, 1.0, (population, 3)) * np.array([spread, spread, math.pi])
            paths = list(pool.map(lambda one: play(*one), zip(starts, weights, strict=True)))
            distances = np.array([recurrent_distance(path) for path in paths])
            order = np.argsort(-distances)
            elite = weights[order[: max(3, int(_ELITE * population))]]
            mean, deviation = elite.mean(axis=0), 0.8 * elite.std(axis=0) + 0.02
            if distances[order[0]] > best.distance:
                best = Attack(float(distances[order[0]]), weights[order[0]], paths[order[0]])
            if each is not None:
                each(best.distance)
    return best
