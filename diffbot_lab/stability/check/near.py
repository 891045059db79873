"""How far from the goal Omega_L can last, by the checker's own bounds.

While the measured distance does not count as outside, the true one is within the leaving radius and the error of the
estimate. After that there are as many steps outwards as end the region. In each of them the rotation may be any. A leg
of the finish may go in any direction with its own speed; how far it goes on purpose follows from where it may begin.
"""

from __future__ import annotations

import math

from diffbot_control.law.configuration import ControllerConfig
from diffbot_control.law.finish import fastest_leg, longest_reach, v_sigma_max
from diffbot_control.law.regions import LEAVE_SIGMAS, RETREAT_MARGIN
from diffbot_core.errors import DiffbotError
from diffbot_lab.stability.check.commands import (
    SLACK,
    Command,
    Numbers,
    Range,
    approach_range,
    cosine_range,
    product,
)
from diffbot_lab.stability.check.steps import Box, clipped, farthest_after, motion_of, slice_count, slice_of
from diffbot_lab.stability.compiled import compile_bounds

_RINGS, _COLUMNS, _ROTATIONS, _SLICE = 10, 180, 24, 0.03
"""how finely Omega_L is cut: rings of distance, columns of alpha from 0 to pi, parts of the rotation, [rad]"""


def leaving_radius(config: ControllerConfig, sigma_max: float, reach: float) -> float:
    """Largest measured distance [m] that may not count as outside: a fixed point of the leaving radius.

    It rises with the distance, but is bounded and concave: iterated from its bound it falls to the fixed point.

    Args:
        config: of the controller.
        sigma_max: [m] largest standard deviation of the position.
        reach: [m] distance from the goal to which a leg of the finish goes; 0 without a leg.
    """
    policy, tolerance = config.region_policy.covariance, config.tolerance.xy_goal_tolerance
    base = max(policy.eps_P_min, policy.eps_P_sigmas * sigma_max)
    radius = policy.eps_P_leave_factor * (base + policy.eps_P_speed_error)
    for _ in range(100):
        radius = policy.eps_P_leave_factor * (base + policy.eps_P_speed_error * math.tanh(radius)) + SLACK
    # With a smaller sigma all of these are smaller.
    return max(radius, policy.eps_P_leave_min, tolerance + LEAVE_SIGMAS * sigma_max + SLACK, RETREAT_MARGIN * reach)


def step_bound(loop: Numbers, speed: float) -> float:
    """Longest way [m] in one step at a requested speed [m/s], any rotation."""
    return loop.t_s * (speed + loop.noise * max(speed, loop.half * loop.omega_max) + loop.eps_v) + SLACK


def longest_step(loop: Numbers, distance: float) -> float:
    """Longest way [m] in one step that is led towards a goal measured within a distance [m]."""
    return step_bound(loop, approach_range(loop, 0.0, distance)[1])


def limited_range(v: Range, least: float, most: float) -> Range:
    """Bounds of a speed that is clipped to +- a bound in [least, most]."""
    low = min(v[0], least) if v[0] > 0.0 else max(v[0], -most)
    high = min(v[1], most) if v[1] > 0.0 else max(v[1], -least)
    return low, high


def farthest_of_ring(loop: Numbers, r0: float, r1: float, columns: int, rotations: int, width: float) -> float:
    """Largest distance [m] after a step of Omega_L from between r0 > ``eps_rho`` and r1 [m], whatever the robot turns.

    Omega_L clips the rotation to omega_max, and the speed to what the rims then leave; the base may turn otherwise.
    """
    least, farthest = max(loop.rim - loop.half * loop.omega_max - SLACK, 0.0), 0.0
    for column in range(columns):
        a0, a1 = column * math.pi / columns - SLACK, (column + 1) * math.pi / columns + SLACK
        box = Box(r0, r1, a0, a1, 0.0, 0.0)
        parts = slice_count(loop, box, width)
        for part in range(parts):
            one = slice_of(loop, box, part, parts)
            speed = approach_range(loop, max(one.near, 0.0), one.far)
            for turns in range(-1, 2):
                alpha = clipped(one.p, one.q, turns)
                if not one.possible or alpha[0] > alpha[1]:
                    continue
                low, high = limited_range(product(speed, cosine_range(alpha[0], alpha[1])), least, loop.v_max)
                for rotation in range(rotations):
                    w0 = (2.0 * rotation / rotations - 1.0) * loop.omega_max - SLACK
                    w1 = (2.0 * (rotation + 1) / rotations - 1.0) * loop.omega_max + SLACK
                    u0, u1, z0, z1 = motion_of(loop, Command(low, high, w0, w1))
                    farthest = max(farthest, farthest_after(box, u0, u1, z0, z1))
    return farthest + loop.t_s * loop.eps_v + SLACK


_ring_kernel = compile_bounds(farthest_of_ring)


def local_reach(loop: Numbers, rho: float) -> float:
    """Largest distance [m] one step of Omega_L without a leg of the finish after any state within ``rho`` [m].

    Raises:
        DiffbotError: if the position is not known well enough for it.
    """
    inner = rho - longest_step(loop, rho + loop.eps_rho)
    if not inner > 1.01 * loop.eps_rho:
        raise DiffbotError("not verified: the leaving radius is too small for the error of the position")
    farthest, width = rho, (rho - inner) / _RINGS
    for ring in range(_RINGS):
        r0, r1 = inner + ring * width - SLACK, inner + (ring + 1) * width + SLACK
        farthest = max(farthest, float(_ring_kernel(loop, r0, r1, _COLUMNS, _ROTATIONS, _SLICE)))
    return farthest


def farthest_local(loop: Numbers, config: ControllerConfig, sigma_max: float) -> float:
    """Largest true distance [m] at which Omega_L may still be in force, or just be left.

    A V begins at a pose that does not count as outside, with a position that is certain enough: its lateral error is at
    most the radius without a leg and with that deviation.
    """
    lateral = leaving_radius(config, min(sigma_max, v_sigma_max(config.tolerance)), 0.0)
    leaving = leaving_radius(config, sigma_max, longest_reach(lateral, config.tolerance))
    leg = step_bound(loop, fastest_leg(config.finish))
    rho = leaving + loop.eps_rho
    for _ in range(config.region_policy.covariance.eps_P_leave_steps):
        rho = max(local_reach(loop, rho), rho + leg)
    return rho
