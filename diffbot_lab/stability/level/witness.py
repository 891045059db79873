"""From below: a state and a noise with which V does not decrease, by the project's own law and plant."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from diffbot_control.law.polar_coordinates import navigation_variables
from diffbot_core.geometry import Pose, wrap_angle
from diffbot_lab.stability.level.problem import LevelProblem, Witness
from diffbot_lab.stability.level.step import MARGIN, levels

Array = NDArray[np.float64]

SCAN = 48
"""distances tried for one choice"""
_NEARLY_PI = math.pi - 1e-9
"""[rad] Rounding must not decide on which side of the cut alpha is measured."""


def witness_at(choice: Array, rho: float, problem: LevelProblem) -> Witness:
    """Return the witness at distance ``rho`` [m] in which the robot measures a chosen alpha.

    Args:
        choice: (7,) numbers in [-1, 1]: beta, the measured alpha, and the five errors, each as a share of its bound.
        rho: [m].
        problem: law, plant and noise.
    """
    beta, measured = math.pi * abs(choice[0]), _NEARLY_PI * choice[1]
    eps_x, eps_y, eps_theta = choice[2] * problem.eps_x, choice[3] * problem.eps_y, choice[4] * problem.eps_theta
    seen = navigation_variables(Pose(eps_x - rho * math.cos(beta), eps_y - rho * math.sin(beta), 0.0))
    theta = seen.beta - measured - eps_theta
    alpha = wrap_angle(beta - theta)
    return Witness(rho, alpha, beta, eps_x, eps_y, eps_theta, choice[5] * problem.eps_v, choice[6] * problem.eps_omega)


def rise_of(witness: Witness, problem: LevelProblem) -> float:
    """Simulate one step; return the change of V."""
    before, after = levels(witness, problem)
    return after - before


def farthest(choice: Array, rho_max: float, problem: LevelProblem) -> float:
    """Return the largest distance [m] found, up to ``rho_max``, at which V rises with a choice; 0 for none."""
    for i in range(SCAN, 0, -1):
        low = rho_max * i / SCAN
        if rise_of(witness_at(choice, low, problem), problem) > MARGIN:
            high = min(low + rho_max / SCAN, rho_max)
            for _ in range(40):
                middle = 0.5 * (low + high)
                if rise_of(witness_at(choice, middle, problem), problem) > MARGIN:
                    low = middle
                else:
                    high = middle
            return low
    return 0.0


def climb(choice: Array, normal: Array, rho_max: float, problem: LevelProblem) -> float:
    """Improve ``choice`` (7,), in place, by random search: one parent, one child, a step that follows the successes.

    Args:
        choice: see :func:`witness_at`.
        normal: (n, 7) independent normal numbers.
        rho_max: [m] of the states looked at.
        problem: law, plant and noise.

    Returns:
        V of the highest state at which V rises with the choice; 0 if none was found.
    """
    best, step = _highest(choice, rho_max, problem), 0.5
    for i in range(len(normal)):
        child = np.minimum(np.maximum(choice + step * normal[i], -1.0), 1.0)
        level = _highest(child, rho_max, problem)
        if level > best or (best == 0.0 and level == 0.0):
            choice[:] = child
            step = min(1.6 * step, 0.5) if level > best else step
            best = level
        else:
            step = max(0.9 * step, 1e-8)
    return best


def _highest(choice: Array, rho_max: float, problem: LevelProblem) -> float:
    rho = farthest(choice, rho_max, problem)
    return levels(witness_at(choice, rho, problem), problem)[0] if rho > 0.0 else 0.0
