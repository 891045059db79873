"""The paper's loop as the adversary plays against it: the project's own law, regions and plant."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from diffbot_control.law.lyapunov_law import Gains, global_law, local_law
from diffbot_control.law.polar_coordinates import navigation_variables
from diffbot_control.law.regions import OMEGA_G, FixedRegionPolicy, fixed_region
from diffbot_core.geometry import Pose, wrap_angle
from diffbot_core.kinematics import Twist
from diffbot_lab.stability.adversary.search import CANDIDATES, STEPS, noise_of, score
from diffbot_lab.stability.interval.compiled import compile_bounds
from diffbot_lab.stability.paper.file import EXACT_ARC, Loop
from diffbot_sim.model.plant import integrate

Array = NDArray[np.float64]


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


def _play(opponent: Opponent, start: Any, weights: Any, path: Any) -> None:
    """Fill ``path`` (steps, 3) with the poses of the greedy adversary."""
    pose, region = Pose(start[0], start[1], start[2]), OMEGA_G
    for step in range(len(path)):
        best, best_pose, best_region = -math.inf, pose, region
        for candidate in range(CANDIDATES):
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
