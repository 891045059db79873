"""Images of a cell of (rho, alpha_d, beta_d) under one step of the law with braking profiles, for all admissible noise.

The variables are those of the end that leads, so one table serves both; in Omega_G the law does not depend on which
it is. The measured position is anywhere in a disc about the true one, the measured heading anywhere in an interval.
The measured bearing is cut into slices: a slice gives an interval of the measured distance, and both an interval of
the commands. In Omega_L the rotation is treated as free, so nothing of its finish or heading has to be known.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from diffbot_lab.stability.maker.geometry import bearing_error, goal_after_move, measured_distance
from diffbot_lab.stability.maker.law import Command, Measured, TunedLoop, approach, command_bounds
from diffbot_lab.stability.maker.ranges import (
    absolute,
    add,
    cos,
    div,
    mul,
    sinc,
    sub,
    wrapped,
)

_HAIR = 1e-12
"""[rad] more than the rounding of a full turn"""


class Cell3(NamedTuple):
    """One cell, closed; angles of the end that leads."""

    rho_low: float
    rho_high: float
    alpha_low: float
    alpha_high: float
    beta_low: float
    beta_high: float


class Slice(NamedTuple):
    """Part of what may be measured in a cell; angles not wrapped."""

    near: float
    """[m] measured distance"""
    far: float
    alpha_low: float
    """[rad] measured bearing"""
    alpha_high: float
    turned_low: float
    """[rad] by how much the goal's direction is measured wrong"""
    turned_high: float


def number_of_slices(loop: TunedLoop, cell: Cell3, width: float) -> int:
    """Return into how many slices of at most ``width`` [rad] the measured bearing is cut."""
    reach = bearing_error(loop.eps_position, cell.rho_low) + loop.eps_theta
    return math.ceil((cell.alpha_high - cell.alpha_low + 2.0 * reach) / width)


def slice_of(loop: TunedLoop, cell: Cell3, part: int, parts: int) -> Slice:
    """Return one of the slices that together hold all that may be measured; ``near`` > ``far`` for an empty one."""
    bearing = bearing_error(loop.eps_position, cell.rho_low)
    reach = bearing + loop.eps_theta
    low, high = cell.alpha_low - reach, cell.alpha_high + reach
    p = low if part == 0 else low + (high - low) * (part / parts)
    q = high if part == parts - 1 else low + (high - low) * ((part + 1) / parts)
    d0 = max(p - cell.alpha_high - loop.eps_theta, -bearing)
    d1 = min(q - cell.alpha_low + loop.eps_theta, bearing)
    if d0 > d1:
        return Slice(1.0, 0.0, p, q, 0.0, 0.0)
    near, far = measured_distance(loop.eps_position, cell.rho_low, cell.rho_high, d0, d1)
    return Slice(near, far, p, q, d0, d1)


def images(loop: TunedLoop, cell: Cell3, width: float, out: Any) -> int:
    """Enclose all states one step of Omega_G after the states of a cell.

    Args:
        loop: law, contract and plant.
        cell: with rho_low above ``eps_position`` and the longest step.
        width: [rad] of the slices of the measured bearing.
        out: (n, 6) array for boxes rho, alpha, beta (low, high each), angles not wrapped; see :func:`most_images`.

    Returns:
        The number of boxes; -1 if the measured goal may be at the robot itself.
    """
    parts = number_of_slices(loop, cell, width)
    reach = bearing_error(loop.eps_position, cell.rho_low) + loop.eps_theta
    number = 0
    for part in range(parts):
        one = slice_of(loop, cell, part, parts)
        if one.near > one.far:
            continue
        if not one.near > 0.0:
            return -1
        beta0, beta1 = add(cell.beta_low, cell.beta_high, one.turned_low, one.turned_high)
        for turn_a in range(-1, 2):
            a0, a1 = wrapped(one.alpha_low, one.alpha_high, turn_a)
            # Only these states of the cell can be measured there.
            turned = 2.0 * math.pi * turn_a
            low, high = (
                max(cell.alpha_low, a0 + turned - reach - _HAIR),
                min(cell.alpha_high, a1 + turned + reach + _HAIR),
            )
            if low > high:
                continue
            states = Cell3(cell.rho_low, cell.rho_high, low, high, cell.beta_low, cell.beta_high)
            for turn_b in range(-1, 2):
                b0, b1 = wrapped(beta0, beta1, turn_b)
                if a0 <= a1 and b0 <= b1:
                    command = command_bounds(loop, Measured(one.near, one.far, a0, a1, b0, b1))
                    put_image(loop, states, command, out[number])
                    number += 1
    return number


def most_images(loop: TunedLoop, cell: Cell3, width: float) -> int:
    """Return how many boxes a cell can have at most, for cells of less than pi/2."""
    return 4 * number_of_slices(loop, cell, width) + 8


def put_image(loop: TunedLoop, cell: Cell3, command: Command, box: Any) -> None:
    """Write the bounds of the state after one step under a command with the errors of the wheels.

    The robot moves along the chord of its arc, of length u = t_s v sinc(w / 2) and at the mean heading, w = t_s omega,
    and ends up to t_s eps_v beside.
    """
    u0, u1, z0, z1 = chord(loop, command)
    a0, a1 = sub(cell.alpha_low, cell.alpha_high, 0.5 * z0, 0.5 * z1)
    near, far, turned0, turned1 = goal_after_move(cell.rho_low, cell.rho_high, u0, u1, a0, a1)
    behind = loop.t_s * loop.eps_v
    aside = bearing_error(behind, near) if behind < near else math.pi
    near, far = max(near - behind, 0.0), far + behind
    turned0, turned1 = turned0 - aside, turned1 + aside
    after0, after1 = add(cell.alpha_low, cell.alpha_high, turned0, turned1)
    box[0], box[1] = near, far
    box[2], box[3] = sub(after0, after1, z0, z1)
    box[4], box[5] = add(cell.beta_low, cell.beta_high, turned0, turned1)


def chord(loop: TunedLoop, command: Command) -> tuple[float, float, float, float]:
    """Bounds of the chord's length [m] and of the turn [rad] in one step under a command with the errors of the wheels.

    The errors of the wheels add up to wheel_error max(|v|, half |omega|) in v, and to as much / half in omega.
    """
    v0, v1, w0, w1 = command
    _, speed = absolute(v0, v1)
    _, spin = absolute(w0, w1)
    error = loop.wheel_error * max(speed, loop.half * spin)
    _, twist = div(error, error, loop.half, loop.half)
    twist += loop.eps_omega
    u0, u1 = mul(loop.t_s, loop.t_s, v0 - error, v1 + error)
    z0, z1 = mul(loop.t_s, loop.t_s, w0 - twist, w1 + twist)
    c0, c1 = sinc(0.5 * z0, 0.5 * z1)
    u0, u1 = mul(u0, u1, c0, c1)
    return u0, u1, z0, z1


def local_distance(loop: TunedLoop, cell: Cell3, width: float, rotations: int, box: Any) -> float:
    """Largest distance [m] one step of Omega_L after the states of a cell, whatever the robot turns meanwhile.

    The heading is turned first, the speed gets what is left; the base may turn otherwise than requested.

    Args:
        loop: law, contract and plant.
        cell: as for :func:`images`; beta does not matter.
        width: [rad] of the slices of the measured bearing.
        rotations: number of parts that the range of the rotation is cut into.
        box: (6,) array to work in.
    """
    parts = number_of_slices(loop, cell, width)
    least = min(max(loop.rim - loop.half * loop.omega_max, 0.0), loop.v_max)
    largest = 0.0
    for part in range(parts):
        one = slice_of(loop, cell, part, parts)
        if one.near > one.far:
            continue
        f0, f1 = approach(loop, one.near, one.far)
        c0, c1 = cos(one.alpha_low, one.alpha_high)
        v0, v1 = mul(f0, f1, c0, c1)
        low = min(v0, least) if v0 > 0.0 else max(v0, -loop.v_max)
        high = min(v1, loop.v_max) if v1 > 0.0 else max(v1, -least)
        for index in range(rotations):
            w0 = loop.omega_max * (2.0 * index / rotations - 1.0)
            w1 = loop.omega_max * (2.0 * (index + 1) / rotations - 1.0)
            put_image(loop, cell, Command(low, high, w0, w1), box)
            largest = max(largest, box[1])
    return largest
