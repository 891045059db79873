"""Upper bound of the change of V in one step, over a cell of states and all admissible noise, for law (13).

A cell is an interval of each of rho [m], alpha [rad], beta [rad], of the measured alpha before it is wrapped, of eps_v
[m/s] and of eps_omega [rad/s]. The measured alpha decides the command, and its error mixes the errors of heading and
position. The input noise moves rho and alpha in opposite ways: small intervals of it make the bound sharp. All is
rounded outward (interval/outward.py); the bound holds for every real state and noise of the cell.

The step is that of the plant in the robot's frame, where the goal is at (rho cos alpha, rho sin alpha). With the
command and its noise held for Ts, the robot moves by L in the direction of ``heading``, and turns by w:

- Euler, Eq. (3): L = Ts (v + eps_v), along its own axis;
- exact arc: the chord L = Ts (v + eps_v) sinc(w / 2), in the direction w / 2.

The bearing of the goal then changes by d = atan2(L sin a, rho - L cos a), a = alpha or alpha - w / 2, and
rho+^2 = rho^2 - 2 rho L cos a + L^2, alpha+ = alpha + d - w, beta+ = beta + d, both wrapped.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from diffbot_lab.stability.interval.outward import (
    PI_HIGH,
    TWO_PI_HIGH,
    TWO_PI_LOW,
    Bounds,
    absolute,
    add,
    atan,
    cos,
    div,
    down,
    hull,
    hypot,
    mul,
    sin,
    sinc,
    sqr,
    sqrt,
    sub,
    tanh,
    tanhc,
    up,
    wrapped,
)
from diffbot_lab.stability.level.problem import LevelProblem


class Cell(NamedTuple):
    """Bounds of a cell: distance [m], bearings [rad] of the goal, the measured alpha [rad], input noise."""

    rho0: float
    rho1: float
    alpha0: float
    alpha1: float
    beta0: float
    beta1: float
    measured0: float
    measured1: float
    eps_v0: float
    eps_v1: float
    eps_omega0: float
    eps_omega1: float


def level_bounds(cell: Cell, h: float) -> Bounds:
    """Return bounds of V, Eq. (8), in the cell."""
    a0, a1 = sqr(cell.alpha0, cell.alpha1)
    b0, b1 = sqr(cell.beta0, cell.beta1)
    b0, b1 = mul(b0, b1, h, h)
    r0, r1 = sqr(cell.rho0, cell.rho1)
    s0, s1 = add(a0, a1, b0, b1)
    s0, s1 = add(s0, s1, r0, r1)
    return 0.5 * s0, 0.5 * s1


def bearing_error(cell: Cell, problem: LevelProblem) -> Bounds:
    """Return bounds of the error [rad] of the bearing that the position's error causes.

    The measured position lies in a rectangle around the true one. Seen from the goal the extreme directions are those
    of its corners; the error is the direction of (rho - e_along, -e_across), e in the frame turned by beta.
    """
    reach = hypot(problem.eps_x, problem.eps_x, problem.eps_y, problem.eps_y)[1]
    if not cell.rho0 > up(reach):
        return -PI_HIGH, PI_HIGH
    c0, c1 = cos(cell.beta0, cell.beta1)
    s0, s1 = sin(cell.beta0, cell.beta1)
    x0, x1 = mul(c0, c1, problem.eps_x, problem.eps_x)
    y0, y1 = mul(s0, s1, problem.eps_y, problem.eps_y)
    u0, u1 = mul(s0, s1, problem.eps_x, problem.eps_x)
    v0, v1 = mul(c0, c1, problem.eps_y, problem.eps_y)
    # Corners (eps_x, eps_y) and (eps_x, -eps_y); the other two are their mirror images.
    along0, along1 = add(x0, x1, y0, y1)
    across0, across1 = sub(u0, u1, v0, v1)
    low, high = _corner_pair(cell.rho0, cell.rho1, along0, along1, across0, across1)
    along0, along1 = sub(x0, x1, y0, y1)
    across0, across1 = add(u0, u1, v0, v1)
    p, q = _corner_pair(cell.rho0, cell.rho1, along0, along1, across0, across1)
    return hull(low, high, p, q)


def _corner_pair(r0: float, r1: float, along0: float, along1: float, across0: float, across1: float) -> Bounds:
    x0, x1 = sub(r0, r1, along0, along1)
    t0, t1 = div(across0, across1, x0, x1)
    x0, x1 = add(r0, r1, along0, along1)
    q0, q1 = div(-across1, -across0, x0, x1)
    low, high = hull(t0, t1, q0, q1)
    return atan(low, high)


def narrowed(cell: Cell, problem: LevelProblem, level: float) -> tuple[bool, Cell, float, float]:
    """Leave out of the cell what the noise cannot cause and what is not above the level.

    Returns:
        False if nothing is left; the narrower cell; bounds of the error of the bearing.
    """
    e0, e1 = bearing_error(cell, problem)
    low, high = sub(e0, e1, -problem.eps_theta, problem.eps_theta)
    m0, m1 = add(cell.alpha0, cell.alpha1, low, high)
    m0, m1 = max(m0, cell.measured0), min(m1, cell.measured1)
    a0, a1 = sub(m0, m1, low, high)
    a0, a1 = max(a0, cell.alpha0), min(a1, cell.alpha1)
    # rho^2 > 2 level - alpha^2 - h beta^2
    of_angles = Cell(0.0, 0.0, a0, a1, cell.beta0, cell.beta1, m0, m1, 0.0, 0.0, 0.0, 0.0)
    rest = level_bounds(of_angles, problem.h)[1]
    r0 = max(cell.rho0, sqrt(max(down(2.0 * down(level - rest)), 0.0), 1e9)[0])
    left = m0 <= m1 and a0 <= a1 and r0 <= cell.rho1
    # The error of the bearing is that of alpha less that of the heading.
    d0, d1 = sub(m0, m1, a0, a1)
    d0, d1 = add(d0, d1, -problem.eps_theta, problem.eps_theta)
    noise = cell.eps_v0, cell.eps_v1, cell.eps_omega0, cell.eps_omega1
    narrow = Cell(r0, cell.rho1, a0, a1, cell.beta0, cell.beta1, m0, m1, noise[0], noise[1], noise[2], noise[3])
    return left, narrow, max(e0, d0), min(e1, d1)


def rise(cell: Cell, problem: LevelProblem, level: float) -> float:
    """Upper bound of V+ - V over the states of the cell with V > ``level`` and all admissible noise; -inf if none."""
    left, cell, e0, e1 = narrowed(cell, problem, level)
    if not left:
        return -math.inf
    beta0, beta1 = add(cell.beta0, cell.beta1, e0, e1)
    if beta1 > math.pi or beta0 < -math.pi:
        beta0, beta1 = -PI_HIGH, PI_HIGH
    worst = -math.inf
    # The measured alpha is wrapped to [-pi, pi], on which side of the cut soever it lies.
    for turn in range(-1, 2):
        m0, m1 = wrapped(cell.measured0, cell.measured1, turn)
        if m0 <= m1:
            worst = max(worst, _rise_for(cell, m0, m1, beta0, beta1, problem))
    return worst


def _rise_for(cell: Cell, m0: float, m1: float, beta0: float, beta1: float, problem: LevelProblem) -> float:
    """Upper bound of V+ - V if alpha and beta are measured in these intervals, wrapped."""
    u0, u1, w0, w1 = motion(cell, m0, m1, beta0, beta1, problem)
    a0, a1 = cell.alpha0, cell.alpha1
    if problem.exact_arc:
        a0, a1 = sub(a0, a1, 0.5 * w0, 0.5 * w1)
        s0, s1 = sinc(0.5 * w0, 0.5 * w1)
        u0, u1 = mul(u0, u1, s0, s1)
    c0, c1 = cos(a0, a1)
    s0, s1 = sin(a0, a1)
    p0, p1 = mul(cell.rho0, cell.rho1, c0, c1)
    x0, x1 = mul(u0, u1, c0, c1)
    x0, x1 = sub(cell.rho0, cell.rho1, x0, x1)
    y0, y1 = mul(u0, u1, s0, s1)
    d0, d1 = -PI_HIGH, PI_HIGH
    if x0 > 0.0:
        q0, q1 = div(y0, y1, x0, x1)
        d0, d1 = atan(q0, q1)
    # L (L / 2 - rho cos a) is convex in L: largest at an end.
    first0, first1 = sub(0.5 * u0, 0.5 * u0, p0, p1)
    second0, second1 = sub(0.5 * u1, 0.5 * u1, p0, p1)
    nearer = max(mul(u0, u0, first0, first1)[1], mul(u1, u1, second0, second1)[1])
    t0, t1 = sub(d0, d1, w0, w1)
    of_alpha = _rise_of_square(cell.alpha0, cell.alpha1, t0, t1)
    of_beta = up(problem.h * _rise_of_square(cell.beta0, cell.beta1, d0, d1))
    return up(nearer + up(of_alpha + of_beta))


def motion(
    cell: Cell, m0: float, m1: float, beta0: float, beta1: float, problem: LevelProblem
) -> tuple[float, float, float, float]:
    """Return bounds of Ts (v + eps_v) [m] and Ts (omega + eps_omega) [rad].

    Args:
        cell: its true distance and input noise.
        m0: [rad] smallest measured alpha, in [-pi, pi].
        m1: [rad] largest.
        beta0: [rad] smallest measured beta.
        beta1: [rad] largest.
        problem: law and noise.
    """
    reach = hypot(problem.eps_x, problem.eps_x, problem.eps_y, problem.eps_y)[1]
    r0, r1 = max(down(cell.rho0 - reach), 0.0), up(cell.rho1 + reach)
    c0, c1 = cos(m0, m1)
    c0, c1 = mul(c0, c1, problem.gamma, problem.gamma)
    p0, p1 = tanh(r0, r1)
    v0, v1 = mul(p0, p1, c0, c1)
    # omega = k alpha + gamma tanhc(rho) cos(alpha) (sin(alpha) + h beta sinc(alpha))
    p0, p1 = sinc(m0, m1)
    q0, q1 = mul(beta0, beta1, problem.h, problem.h)
    q0, q1 = mul(p0, p1, q0, q1)
    s0, s1 = sin(m0, m1)
    s0, s1 = add(s0, s1, q0, q1)
    p0, p1 = tanhc(r0, r1)
    p0, p1 = mul(p0, p1, c0, c1)
    p0, p1 = mul(p0, p1, s0, s1)
    q0, q1 = mul(m0, m1, problem.k, problem.k)
    w0, w1 = add(p0, p1, q0, q1)
    v0, v1 = add(v0, v1, cell.eps_v0, cell.eps_v1)
    w0, w1 = add(w0, w1, cell.eps_omega0, cell.eps_omega1)
    v0, v1 = mul(v0, v1, problem.t_s, problem.t_s)
    w0, w1 = mul(w0, w1, problem.t_s, problem.t_s)
    return v0, v1, w0, w1


def _rise_of_square(a0: float, a1: float, t0: float, t1: float) -> float:
    """Upper bound of (wrapped(a + t)^2 - a^2) / 2 for a in [-pi, pi]."""
    least = sqr(a0, a1)[0]
    widest = 0.5 * up(up(PI_HIGH * PI_HIGH) - least)
    low, high = add(a0, a1, t0, t1)
    if low < -9.0 or high > 9.0:
        return widest
    worst = -math.inf
    for turn in range(-1, 2):
        shift0 = turn * (TWO_PI_LOW if turn > 0 else TWO_PI_HIGH)
        shift1 = turn * (TWO_PI_HIGH if turn > 0 else TWO_PI_LOW)
        b0, b1 = sub(low, high, shift0, shift1)
        b0, b1 = max(b0, -PI_HIGH), min(b1, PI_HIGH)
        if b0 <= b1:
            s0, s1 = sub(t0, t1, shift0, shift1)
            q0, q1 = add(2.0 * a0, 2.0 * a1, s0, s1)
            product = 0.5 * mul(s0, s1, q0, q1)[1]
            farthest = absolute(b0, b1)[1]
            worst = max(worst, min(product, 0.5 * up(up(farthest * farthest) - least)))
    return worst
