"""Images of a cell of (rho, alpha) under one step of the paper's loop, for every admissible noise.

The goal's bearing in its own frame, beta, is treated as a disturbance in [-pi, pi]: a step from (rho, alpha) then
depends on nothing else, and what holds for every beta holds for the true one. The bearing that is measured is cut into
slices. A slice gives an interval of the measured distance, since both come from one error of the position in a disc,
and both give intervals of v and omega, and these the image. See docs/explanation/stability.md.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from diffbot_lab.stability.interval.ranges import (
    Bounds,
    add,
    cos,
    mul,
    sin,
    sinc,
    sub,
    tanh,
    tanhc,
    wrapped,
)
from diffbot_lab.stability.rank.cells import Cell
from diffbot_lab.stability.rank.geometry import bearing_error, goal_after_move, measured_distance


class PaperLoop(NamedTuple):
    """Law (13) or (17), noise and plant."""

    gamma: float
    """[m/s]"""
    k: float
    """[1/s]"""
    h: float
    """[-]"""
    k_2: float
    """[1/s]"""
    eps_P: float
    """[m] below it Omega_L may be in force; 0 with ``eps_P_leave`` 0: never, law (13)"""
    eps_P_leave: float
    """[m] above it Omega_G is in force; in between either may be, which covers the hysteresis and the paper's rule"""
    eps_position: float
    """[m] bound of the distance of the measured from the true position"""
    eps_theta: float
    """[rad] <= pi"""
    eps_v: float
    """[m/s]"""
    eps_omega: float
    """[rad/s]"""
    t_s: float
    """[s]"""
    exact_arc: bool
    """the plant follows the arc; otherwise Euler's step, Eq. (3)"""
    slice_width: float
    """[rad] of the measured bearing"""


class Measured(NamedTuple):
    """Bounds of what the law is given."""

    rho_low: float
    rho_high: float
    alpha_low: float
    """[rad] wrapped"""
    alpha_high: float


def most_images(loop: PaperLoop, rho: float) -> int:
    """Return how many images a cell at ``rho`` [m] or beyond can have at most, for columns of up to 1 rad."""
    reach = math.asin(min(1.0, loop.eps_position / rho)) + loop.eps_theta
    return 4 * (math.ceil((2.0 * reach + 1.0) / loop.slice_width) + 4)


def images(loop: PaperLoop, cell: Cell, out: Any) -> int:
    """Enclose all states one step after the states of a cell.

    Args:
        loop: law, noise and plant.
        cell: with rho_low above ``eps_position`` and above the longest step.
        out: (n, 4) array for the boxes rho_low, rho_high [m], alpha_low, alpha_high [rad], angles not wrapped; see
            :func:`most_images`. Their union holds every image.

    Returns:
        The number of boxes.
    """
    bearing = bearing_error(loop.eps_position, cell.rho_low)
    reach = bearing + loop.eps_theta
    low, high = cell.alpha_low - reach, cell.alpha_high + reach
    parts = math.ceil((high - low) / loop.slice_width)
    number = 0
    p = low
    for part in range(parts):
        q = high if part == parts - 1 else low + (high - low) * ((part + 1) / parts)
        near, far = _measured_distance(loop, cell, bearing, p, q)
        # A measured bearing beyond the cut is wrapped before the law uses it.
        for turn in range(-1, 2):
            a0, a1 = wrapped(p, q, turn)
            if near <= far and a0 <= a1:
                number = _images_of_slice(loop, cell, Measured(near, far, a0, a1), out, number)
        p = q
    return number


def _measured_distance(loop: PaperLoop, cell: Cell, bearing: float, p: float, q: float) -> Bounds:
    """Bounds of the measured distance [m] if the measured bearing, not wrapped, is in [p, q]; empty if it cannot be."""
    d0 = max(p - cell.alpha_high - loop.eps_theta, -bearing)
    d1 = min(q - cell.alpha_low + loop.eps_theta, bearing)
    if d0 > d1:
        return 1.0, 0.0
    return measured_distance(loop.eps_position, cell.rho_low, cell.rho_high, d0, d1)


def _images_of_slice(loop: PaperLoop, cell: Cell, measured: Measured, out: Any, number: int) -> int:
    """Append the images under the commands of Omega_G and of Omega_L, as far as each may be in force."""
    near, far, a0, a1 = measured
    if far >= loop.eps_P:
        seen = Measured(max(near, loop.eps_P), far, a0, a1)
        v0, v1 = _speed(loop, seen)
        w0, w1 = _steering(loop, seen)
        _put_image(loop, cell, v0, v1, (w0, w1), out[number])
        number += 1
    if loop.eps_P_leave > 0.0 and near <= loop.eps_P_leave:
        v0, v1 = _speed(loop, Measured(near, min(far, loop.eps_P_leave), a0, a1))
        # The heading that is held at 0 is any, as beta is.
        _, w1 = mul(loop.k_2, loop.k_2, math.pi, math.pi)
        _put_image(loop, cell, v0, v1, (-w1, w1), out[number])
        number += 1
    return number


def _speed(loop: PaperLoop, measured: Measured) -> Bounds:
    """Bounds of v = gamma tanh(rho) cos(alpha) [m/s]."""
    t0, t1 = tanh(measured.rho_low, measured.rho_high)
    g0, g1 = mul(loop.gamma, loop.gamma, t0, t1)
    c0, c1 = cos(measured.alpha_low, measured.alpha_high)
    return mul(g0, g1, c0, c1)


def _steering(loop: PaperLoop, measured: Measured) -> Bounds:
    """Bounds of omega [rad/s] of law (13).

    It is k alpha + gamma tanhc(rho) cos(alpha) (sin(alpha) + h beta sinc(alpha)), beta in [-pi, pi].
    """
    a0, a1 = measured.alpha_low, measured.alpha_high
    t0, t1 = tanhc(measured.rho_low, measured.rho_high)
    c0, c1 = cos(a0, a1)
    t0, t1 = mul(t0, t1, c0, c1)
    t0, t1 = mul(loop.gamma, loop.gamma, t0, t1)
    b0, b1 = mul(loop.h, loop.h, -math.pi, math.pi)
    c0, c1 = sinc(a0, a1)
    b0, b1 = mul(b0, b1, c0, c1)
    s0, s1 = sin(a0, a1)
    s0, s1 = add(s0, s1, b0, b1)
    t0, t1 = mul(t0, t1, s0, s1)
    p0, p1 = mul(loop.k, loop.k, a0, a1)
    return add(p0, p1, t0, t1)


def _put_image(loop: PaperLoop, cell: Cell, v0: float, v1: float, omega: Bounds, box: Any) -> None:
    """Write the bounds of the state after one step with the input noise.

    The robot moves along a chord. Euler's has the heading at the start. That of the arc has the mean heading, and its
    length u shrinks by sinc(turn / 2).
    """
    u0, u1 = mul(loop.t_s, loop.t_s, v0 - loop.eps_v, v1 + loop.eps_v)
    z0, z1 = mul(loop.t_s, loop.t_s, omega[0] - loop.eps_omega, omega[1] + loop.eps_omega)
    a0, a1 = cell.alpha_low, cell.alpha_high
    if loop.exact_arc:
        c0, c1 = sinc(0.5 * z0, 0.5 * z1)
        u0, u1 = mul(u0, u1, c0, c1)
        a0, a1 = sub(a0, a1, 0.5 * z0, 0.5 * z1)
    near, far, turned0, turned1 = goal_after_move(cell.rho_low, cell.rho_high, u0, u1, a0, a1)
    after0, after1 = add(cell.alpha_low, cell.alpha_high, turned0, turned1)
    box[0], box[1] = near, far
    box[2], box[3] = sub(after0, after1, z0, z1)
