"""How far from the goal the robot can get in Omega_L, whatever the noise: from the switch, not from the law.

In Omega_L the noise can shift the robot sideways for ever, a fraction of a millimetre in each step. What ends that is
the switch: after ``eps_P_leave_steps`` poses in a row measured beyond the leaving radius, Omega_G is in force. So the
true distance is at most that radius, the error of the estimate, and the way outwards of as many steps. In each of these
the robot drives to the goal as it sees it, or a leg of the finish. The leaving radius grows with the reach of the leg.
A V begins at rest, with a position that is certain enough, and measured within the radius without a leg: that bounds
the lateral error, and with it the reach.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from diffbot_control.law.configuration import ControllerConfig
from diffbot_control.law.finish import fastest_leg, longest_reach, v_sigma_max
from diffbot_control.law.regions import LEAVE_SIGMAS, RETREAT_MARGIN
from diffbot_core.errors import DiffbotError
from diffbot_lab.stability.compiled import compile_bounds
from diffbot_lab.stability.maker.images import Cell3, local_distance
from diffbot_lab.stability.maker.law import TunedLoop, approach

_ROUNDING = 1e-9
"""[m] and [rad] more than the rounding of a few operations"""
_RINGS, _COLUMNS, _ROTATIONS, _SLICE = 8, 180, 24, 0.03
"""how finely the states of Omega_L are cut: rings of distance, columns of alpha, parts of the rotation, [rad]"""


class NearBounds(NamedTuple):
    """What holds in Omega_L."""

    resting: float
    """[m] measured distance beyond which the switch counts without a leg ..."""
    leaving: float
    """[m] ... and on the leg with the longest reach"""
    holding: float
    """[m] true distance at which Omega_L ends at the latest"""


def resting_radius(config: ControllerConfig, sigma_max: float) -> float:
    """Measured distance [m] beyond which a pose counts as outside of Omega_L for every sigma up to ``sigma_max``.

    It is that without a leg. The radius is factor (base + share tanh(rho)), and tanh(rho) <= rho: beyond
    factor base / (1 - factor share) it is smaller than rho.

    Raises:
        DiffbotError: if the radius grows as fast as the distance.
    """
    policy = config.region_policy.covariance
    slope = policy.eps_P_leave_factor * policy.eps_P_speed_error
    if not slope < 1.0:
        raise DiffbotError("no certificate: eps_P_leave_factor * eps_P_speed_error must be below 1")
    base = policy.eps_P_leave_factor * max(policy.eps_P_min, policy.eps_P_sigmas * sigma_max)
    doubtful = config.tolerance.xy_goal_tolerance + LEAVE_SIGMAS * sigma_max
    return max(policy.eps_P_leave_min, doubtful, base / (1.0 - slope)) + _ROUNDING


def longest_step(loop: TunedLoop, speed: float) -> float:
    """Longest way [m] in one step at a requested speed [m/s], any rotation."""
    error = loop.wheel_error * max(speed, loop.half * loop.omega_max)
    return loop.t_s * (speed + error + loop.eps_v) + _ROUNDING


def largest_local_distance(loop: TunedLoop, low: float, high: float, rings: int) -> float:
    """Largest distance [m] one step of Omega_L after any state between the distances ``low`` and ``high``."""
    box = np.empty(6)
    largest = 0.0
    for ring in range(rings):
        for column in range(_COLUMNS):
            cell = Cell3(
                low + (high - low) * (ring / rings),
                high if ring == rings - 1 else low + (high - low) * ((ring + 1) / rings),
                math.pi * column / _COLUMNS - _ROUNDING,
                math.pi * (column + 1) / _COLUMNS + _ROUNDING,
                0.0,
                0.0,
            )
            largest = max(largest, local_distance(loop, cell, _SLICE, _ROTATIONS, box))
    return largest


_largest_kernel = compile_bounds(largest_local_distance)


def local_reach(loop: TunedLoop, rho: float) -> float:
    """Largest distance [m] one step of Omega_L without a leg after any state within ``rho``.

    Nearer than the longest step, no state leaves the circle; the rest is cut into rings.

    Raises:
        DiffbotError: if the circle is too small for the images.
    """
    far = rho + loop.eps_position
    low = rho - longest_step(loop, approach(loop, far, far)[1])
    if not low > loop.eps_position:
        raise DiffbotError("no certificate: the leaving radius is too small for the error of the position")
    return max(rho, float(_largest_kernel(loop, low, rho, _RINGS)) + _ROUNDING)


def near_bounds(loop: TunedLoop, config: ControllerConfig, sigma_max: float) -> NearBounds:
    """Work out the bounds of Omega_L.

    Args:
        loop: law, contract and plant.
        config: of the controller.
        sigma_max: [m] largest standard deviation of the position.

    Raises:
        DiffbotError: for a configuration that is not covered.
    """
    resting = resting_radius(config, sigma_max)
    lateral = resting_radius(config, min(sigma_max, v_sigma_max(config.tolerance)))
    leaving = max(resting, RETREAT_MARGIN * longest_reach(lateral, config.tolerance) + _ROUNDING)
    leg = longest_step(loop, min(fastest_leg(config.finish), loop.v_max))
    steps = config.region_policy.covariance.eps_P_leave_steps
    return NearBounds(resting, leaving, _after_leaving(loop, leaving, steps, leg))


def _after_leaving(loop: TunedLoop, leaving: float, steps: int, leg: float) -> float:
    """Largest distance [m] so many steps after a pose measured within ``leaving`` [m]."""
    reach = leaving + loop.eps_position + _ROUNDING
    for _ in range(steps):
        reach = max(local_reach(loop, reach), reach + leg)
    return reach
