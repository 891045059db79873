"""The loop of the law as the adversary plays against it, and random errors within its contract."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from diffbot_control.law.configuration import new_memory
from diffbot_core.geometry import Pose
from diffbot_lab.stability.adversary.search import CANDIDATES, STEPS, noise_of, score
from diffbot_lab.stability.compiled import compile_bounds
from diffbot_lab.stability.file import Certificate
from diffbot_lab.stability.runs import ContractLoop, drive, next_pose, sample, sigma_at

Array = NDArray[np.float64]

_AFTERWARDS = 20
"""steps of a run after the certified time"""


class Observed(NamedTuple):
    """Counts and distances of random errors."""

    steps_from_core: int
    """steps that began in the core ..."""
    left_core: int
    """... and ended outside of it"""
    trajectories: int
    """from all over the start ..."""
    late: int
    """... and of all runs, the ones that broke a rank"""
    longest: int
    """steps until a trajectory was in the core for good"""
    farthest: float
    """[m] distance from the goal at the end of the trajectories"""
    cloud: Array
    """(n, 3) poses there"""


def errors_of(candidate: int, pose: Pose) -> tuple[float, float, float, float, float, float, float, float]:
    """Return the errors of a candidate for :func:`next_pose`; what the base adds leads away from the goal."""
    x, y, theta, left, right = noise_of(candidate)
    rho = max(math.hypot(pose.x, pose.y), 1e-9)
    return x, y, theta, left, right, pose.x / rho, pose.y / rho, 0.5 * (right - left)


def _play(loop: ContractLoop, start: Any, weights: Any, path: Any) -> None:
    """Fill ``path`` (steps, 3) with the poses of the greedy adversary."""
    pose, memory = Pose(start[0], start[1], start[2]), new_memory()
    for step in range(len(path)):
        best, best_pose, best_memory = -math.inf, pose, memory
        for candidate in range(CANDIDATES):
            errors = errors_of(candidate, pose)
            after, after_memory = next_pose(loop, pose, memory, sigma_at(loop, pose), errors)
            value = score(after, weights)
            if value > best:
                best, best_pose, best_memory = value, after, after_memory
        pose, memory = best_pose, best_memory
        path[step, 0], path[step, 1], path[step, 2] = pose.x, pose.y, pose.theta


_play_kernel = compile_bounds(_play)


def play(loop: ContractLoop, start: Array, weights: Array, steps: int = STEPS) -> Array:
    """Return the poses (steps, 3) under the adversary with these weights, from a start x, y [m], theta [rad]."""
    path: Array = np.empty((steps, 3))
    _play_kernel(loop, start, weights, path)
    return path


def observe(certificate: Certificate, steps: int, trajectories: int, seed: int) -> Observed:
    """Simulate with random errors within the contract.

    Args:
        certificate: to compare with.
        steps: at least so many from drawn memories.
        trajectories: from starts within ``claims.start`` with a new goal.
        seed: of starts and errors.
    """
    claims = certificate.claims
    length = claims.steps + _AFTERWARDS
    runs, ends = drive(certificate, trajectories, claims.start, length, seed, any_memory=False)
    drawn = sample(certificate, steps, seed + 1)
    return Observed(
        runs.from_core + drawn.from_core,
        runs.left_core + drawn.left_core,
        trajectories,
        runs.broken + drawn.broken,
        runs.longest,
        float(np.hypot(ends[:, 0], ends[:, 1]).max()),
        ends,
    )
