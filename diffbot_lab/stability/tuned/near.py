"""How far from the goal the robot can get in Omega_L, whatever the noise: from the switch, not from the law.

In Omega_L the noise can shift the robot sideways for ever, a fraction of a millimetre in each step. What ends that is
the switch: after ``eps_P_leave_steps`` poses in a row measured beyond the leaving radius, Omega_G is in force. So the
true distance is at most that radius, the error of the estimate, and the way outwards of as many steps. The finish adds
its way out, whose length follows from the lateral error measured at its beginning.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from diffbot_control.law.configuration import ControllerConfig
from diffbot_control.law.finish import (
    END_GAIN,
    LINE_GAIN,
    OUT_END,
    OUT_HEADING,
    OUT_SLOPE,
    OUT_SPEED,
    SHORTEST_LEG,
    SLOWEST,
)
from diffbot_control.law.regions import RETREAT_MARGIN, CovarianceRegionPolicy
from diffbot_core.errors import DiffbotError
from diffbot_lab.stability.interval.compiled import compile_bounds
from diffbot_lab.stability.interval.outward import absolute, add, down, mul, sin, sub, up
from diffbot_lab.stability.tuned.images import Cell3, chord, local_distance
from diffbot_lab.stability.tuned.law import Command, TunedLoop, approach, profile_gain

_ROUNDING = 1e-9
"""[m] and [rad] added to sums of a few numbers that are not rounded outward one by one"""
_RINGS, _COLUMNS, _ROTATIONS, _SLICE = 8, 180, 24, 0.03
"""how finely the states of Omega_L are cut: rings of distance, columns of alpha, parts of the rotation, [rad]"""
_TURNED = 0.02
"""[rad] more than the errors of the wheels turn the robot in one step at the speeds of the finish"""
_LATERAL, _HEADING = 0.005, 0.01
"""[m], [rad] cells of the way out"""


class NearBounds(NamedTuple):
    """What holds in Omega_L."""

    leaving: float
    """[m] measured distance beyond which the switch counts, without a way out"""
    holding: float
    """[m] true distance at which Omega_L ends at the latest, without the finish"""
    reach: float
    """[m] of the longest way out along the axis of the goal"""
    aside: float
    """[m] lateral error on a way out"""
    finishing: float
    """[m] true distance at which Omega_L ends at the latest, with the finish"""


class WayOut(NamedTuple):
    """Law of the way out, which is led along the goal's axis."""

    hold_brake: float
    hold_react: float
    line_gain: float
    heading: float
    speed: float
    least_speed: float
    eps_y: float


def leaving_radius(policy: CovarianceRegionPolicy, sigma_max: float, floor: float) -> float:
    """Measured distance [m] beyond which a pose counts as outside of Omega_L for every sigma up to ``sigma_max``.

    Args:
        policy: of the switch.
        sigma_max: [m]
        floor: [m] least leaving radius.

    The radius is factor (base + share tanh(rho)), and tanh(rho) <= rho: beyond factor base / (1 - factor share) it is
    smaller than rho.

    Raises:
        DiffbotError: if the radius grows as fast as the distance.
    """
    slope = policy.eps_P_leave_factor * policy.eps_P_speed_error
    if not slope < 1.0:
        raise DiffbotError("no certificate: eps_P_leave_factor * eps_P_speed_error must be below 1")
    base = policy.eps_P_leave_factor * max(policy.eps_P_min, policy.eps_P_sigmas * sigma_max)
    return max(policy.eps_P_leave_min, base / (1.0 - slope), floor) + _ROUNDING


def longest_step(loop: TunedLoop, speed: float) -> float:
    """Longest way [m] in one step at a commanded speed [m/s], any rotation."""
    spin = up(loop.half * loop.omega_max)
    return up(up(loop.t_s * up(speed + up(loop.drive_noise * max(speed, spin)))) + _ROUNDING)


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
    """Largest distance [m] one step of Omega_L without the finish after any state within ``rho``.

    Nearer than the longest step, no state leaves the circle; the rest is cut into rings.

    Raises:
        DiffbotError: if the circle is too small for the images.
    """
    far = up(rho + loop.eps_position)
    low = rho - longest_step(loop, approach(loop, far, far)[1])
    if not low > loop.eps_position:
        raise DiffbotError("no certificate: the leaving radius is too small for the error of the position")
    return max(rho, float(_largest_kernel(loop, low, rho, _RINGS)) + _ROUNDING)


def near_bounds(loop: TunedLoop, config: ControllerConfig, eps_y: float, sigma_max: float) -> NearBounds:
    """Work out the bounds of Omega_L.

    Args:
        loop: law, contract and plant.
        config: of the controller.
        eps_y: [m] bound of the error of y, and of x.
        sigma_max: [m] largest standard deviation of the position.
    """
    policy, tolerance, finish = config.region_policy.covariance, config.tolerance, config.finish
    length = _length(config)
    floor = max(tolerance.xy_goal_tolerance, RETREAT_MARGIN * max(finish.finish_reach, SHORTEST_LEG) * length)
    leaving = leaving_radius(policy, sigma_max, floor)
    last_inside = leaving + loop.eps_position + _ROUNDING
    holding = last_inside
    for _ in range(policy.eps_P_leave_steps):
        holding = local_reach(loop, holding)
    # A try begins, or turns into a way out, in a pose of Omega_L; before it there are fewer steps than end the region.
    steps = policy.eps_P_leave_steps
    shuttling = max(longest_step(loop, finish.finish_speed), (holding - last_inside) / steps)
    lateral = last_inside + (steps - 1) * max(shuttling, holding - last_inside) + _ROUNDING
    reach = length + OUT_SLOPE * (lateral + eps_y) + _ROUNDING
    way = longest_step(loop, OUT_SPEED)
    # In the first step the end may be behind the robot as measured; from then on that ends the way out. A step turns
    # the robot towards a heading within the law's bound.
    heading = max(OUT_HEADING, tolerance.yaw_goal_tolerance) + loop.eps_theta + _TURNED
    aside = largest_aside(loop, config, lateral + way, heading, eps_y)
    # The leg is over ``OUT_END`` of the length before its end, as measured.
    finishing = max(math.hypot(reach - OUT_END * length + eps_y + way, aside), last_inside) + _ROUNDING
    for _ in range(steps):
        finishing = max(finishing + way, local_reach(loop, finishing))
    return NearBounds(leaving, holding, reach, aside, finishing)


def _length(config: ControllerConfig) -> float:
    length = config.finish.finish_length
    return length if length > 0.0 else config.tolerance.xy_goal_tolerance


def largest_aside(loop: TunedLoop, config: ControllerConfig, lateral: float, heading: float, eps_y: float) -> float:
    """Largest lateral error [m] on a way out that begins with one of ``lateral`` [m] and a heading [rad] at most.

    Cells of (y, theta) are added until no image leaves them. How far out the robot is does not matter: it reverses at
    any speed between the fastest and the one that the end of the way leaves, times the share for the heading.

    Raises:
        DiffbotError: if the cells do not suffice.
    """
    gains, length = config.profile_gains, _length(config)
    slowest = min(OUT_SPEED, max(END_GAIN * OUT_END * length, SLOWEST * config.finish.finish_speed)) - _ROUNDING
    way = WayOut(gains.hold_brake, gains.hold_react, LINE_GAIN, OUT_HEADING, OUT_SPEED, slowest, eps_y)
    rows, columns = math.ceil((lateral + 0.3) / _LATERAL), math.ceil((OUT_HEADING + heading + 0.3) / _HEADING)
    cells = np.zeros((2 * rows, 2 * columns), np.uint8)
    top, side = math.ceil(lateral / _LATERAL), math.ceil(heading / _HEADING)
    cells[rows - top : rows + top, columns - side : columns + side] = 1
    if not _spread_kernel(loop, way, cells):
        raise DiffbotError("no certificate: the way out does not keep to the axis under this noise")
    used = np.flatnonzero(cells.any(axis=1))
    return float(_LATERAL * max(rows - used[0], used[-1] + 1 - rows) + _ROUNDING)


def _spread_way(loop: TunedLoop, way: WayOut, cells: Any) -> bool:
    """Add the cells that the way out leads to until none is new; return False if they do not suffice."""
    rows, columns = cells.shape
    done = np.zeros((rows, columns), np.uint8)
    fresh = 1
    while fresh > 0:
        fresh = 0
        for i in range(rows):
            for j in range(columns):
                if not cells[i, j] or done[i, j]:
                    continue
                done[i, j] = 1
                fresh += 1
                y0, y1, t0, t1 = _way_image(loop, way, (i - rows // 2) * _LATERAL, (j - columns // 2) * _HEADING)
                i0, i1 = math.floor(y0 / _LATERAL) + rows // 2, math.floor(y1 / _LATERAL) + rows // 2
                j0, j1 = math.floor(t0 / _HEADING) + columns // 2, math.floor(t1 / _HEADING) + columns // 2
                if i0 < 0 or j0 < 0 or i1 >= rows or j1 >= columns:
                    return False
                cells[i0 : i1 + 1, j0 : j1 + 1] = 1
    return True


def _way_image(loop: TunedLoop, way: WayOut, y: float, theta: float) -> tuple[float, float, float, float]:
    """Bounds of (y, theta) after a step of the way out from the cell at (y, theta), widened by _ROUNDING.

    The law turns to the heading clip(line_gain y), reversing, and slows down by what is missing to it.
    """
    y0, y1 = y - _ROUNDING, y + _LATERAL + _ROUNDING
    t0, t1 = theta - _ROUNDING, theta + _HEADING + _ROUNDING
    h0 = min(max(down(way.line_gain * down(y0 - way.eps_y)), -way.heading), way.heading)
    h1 = min(max(up(way.line_gain * up(y1 + way.eps_y)), -way.heading), way.heading)
    e0, e1 = sub(down(t0 - loop.eps_theta), up(t1 + loop.eps_theta), h0, h1)
    least, most = absolute(e0, e1)
    share0 = max(down(1.0 - up(most / (2.0 * way.heading))), 0.0)
    share1 = max(up(1.0 - down(least / (2.0 * way.heading))), 0.0)
    v0, v1 = -up(way.speed * share1), -down(way.least_speed * share0)
    w0, w1 = -_turning(loop, way, e1, True), -_turning(loop, way, e0, False)
    u0, u1, z0, z1 = chord(loop, Command(v0, v1, w0, w1))
    m0, m1 = add(t0, t1, 0.5 * z0, 0.5 * z1)
    s0, s1 = sin(m0, m1)
    u0, u1 = mul(u0, u1, s0, s1)
    y0, y1 = add(y0, y1, u0, u1)
    t0, t1 = add(t0, t1, z0, z1)
    return y0 - _ROUNDING, y1 + _ROUNDING, t0 - _ROUNDING, t1 + _ROUNDING


def _turning(loop: TunedLoop, way: WayOut, error: float, highest: bool) -> float:
    """Bound of phi_L(error) [rad/s], from above or below."""
    g0, g1 = profile_gain(abs(error), way.hold_brake, way.hold_react)
    p0, p1 = mul(error, error, g0, g1)
    value = p1 if highest else p0
    return min(max(value, -loop.omega_max), loop.omega_max)


_spread_kernel = compile_bounds(_spread_way)
