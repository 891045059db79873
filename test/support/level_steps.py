"""Random steps of law (13) under noise, and random cells that hold them."""

import math

import numpy as np

from diffbot_control.law.polar_coordinates import navigation_variables
from diffbot_core.geometry import Pose, wrap_angle
from diffbot_lab.stability.level.problem import LevelProblem

PAPER = LevelProblem(1.3, 1.0, 0.17, 0.1, 0.3, 0.3, 0.17, 0.065, 0.2167, exact_arc=False)
PROBLEMS = {
    "Euler": PAPER,
    "exact arc": PAPER._replace(exact_arc=True),
    "large noise": LevelProblem(1.0, 3.0, 2.0, 0.1, 2.0, 0.5, 1.5, 0.5, 2.0, exact_arc=True),
    "any heading": PAPER._replace(eps_theta=math.pi),
    "long steps": LevelProblem(1.3, 8.0, 2.0, 1.0, 0.3, 0.1, 0.3, 0.1, 0.3, exact_arc=True),
    "no noise": LevelProblem(1.3, 1.0, 0.17, 0.1, 0.0, 0.0, 0.0, 0.0, 0.0, exact_arc=False),
}


def side(rng, x, largest, low, high):
    """Interval around x, of any size up to the largest, within [low, high]."""
    width = largest * 10.0 ** (-7.0 * rng.random())
    start = x - width * rng.random()
    return max(start, low), min(start + width, high)


def measured_alpha(step, problem):
    """Alpha as it is measured, before it is wrapped."""
    x, y = step.eps_x - step.rho * math.cos(step.beta), step.eps_y - step.rho * math.sin(step.beta)
    error = wrap_angle(navigation_variables(Pose(x, y, 0.0)).beta - step.beta)
    return step.alpha + error - step.eps_theta


def sides_around(rng, step, problem, largest):
    """Bounds of a cell that holds the step: rho, alpha, beta, measured alpha, eps_v, eps_omega."""
    r0, r1 = side(rng, step.rho, 2.0 * largest, 0.0, 100.0)
    a0, a1 = side(rng, step.alpha, largest, -math.pi, math.pi)
    b0, b1 = side(rng, step.beta, largest, 0.0, math.pi)
    m0, m1 = side(rng, measured_alpha(step, problem), largest, -10.0, 10.0)
    v0, v1 = side(rng, step.eps_v, 0.1 * largest, -problem.eps_v, problem.eps_v)
    w0, w1 = side(rng, step.eps_omega, 0.1 * largest, -problem.eps_omega, problem.eps_omega)
    return r0, r1, a0, a1, b0, b1, m0, m1, v0, v1, w0, w1


def random_choice(rng, choice):
    """Fill the seven numbers of a step: each noise at its bound or within, the measured alpha often near pi."""
    for j in range(7):
        choice[j] = 2.0 * rng.random() - 1.0
        if j >= 2 and rng.random() < 0.5:
            choice[j] = np.sign(choice[j])
    if rng.random() < 0.3:
        choice[1] = 1.0 - 0.05 * rng.random()
