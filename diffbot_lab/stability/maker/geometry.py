"""Geometry of one step: what may be measured of the goal, and where it is after a move.

Only floats come and go, so numba compiles it.
"""

from __future__ import annotations

import math

from diffbot_lab.stability.maker.ranges import (
    Bounds,
    add,
    asin,
    atan2,
    cos,
    div,
    mul,
    sin,
    sqr,
    sqrt,
    sub,
)


def bearing_error(eps_position: float, rho: float) -> float:
    """Largest error [rad] of the goal's direction at a distance ``rho`` > ``eps_position`` [m]."""
    _, ratio = div(eps_position, eps_position, rho, rho)
    return asin(ratio, ratio)[1]


def measured_distance(eps_position: float, rho_low: float, rho_high: float, d0: float, d1: float) -> Bounds:
    """Bounds of the measured distance [m] if the goal's direction is measured wrong by an angle in [d0, d1] [rad].

    The ray at an angle d from the goal meets the disc of the position error between
    rho cos(d) -+ sqrt(eps^2 - rho^2 sin(d)^2). The nearer end rises with |d| and with rho, the farther one falls with
    |d|. No angle is larger than :func:`bearing_error`.
    """
    d = 0.0 if d0 <= 0.0 <= d1 else min(abs(d0), abs(d1))
    c0, c1 = cos(d, d)
    s0, _ = sin(d, d)
    aside = max(rho_low * s0, 0.0)
    y0, _ = sqr(aside, aside)
    _, e1 = sqr(eps_position, eps_position)
    _, half = sqrt(0.0, max(e1 - y0, 0.0))
    return max(rho_low * c0 - half, 0.0), rho_high * c1 + half


def goal_after_move(
    rho_low: float, rho_high: float, u0: float, u1: float, a0: float, a1: float
) -> tuple[float, float, float, float]:
    """Bounds of the goal's distance [m] after a move, and of the angle [rad] by which its direction turns.

    A move of length u at the angle a from the goal leads to rho^2 - 2 rho u cos(a) + u^2, and turns the goal's
    direction by atan2(u sin(a), rho - u cos(a)).

    Args:
        rho_low: [m] bounds of the distance before it ...
        rho_high: [m]
        u0: [m] ... of the length, which may be negative, ...
        u1: [m]
        a0: [rad] ... and of the angle
        a1: [rad]
    """
    c0, c1 = cos(a0, a1)
    s0, s1 = sin(a0, a1)
    along0, along1 = mul(u0, u1, c0, c1)
    aside0, aside1 = mul(u0, u1, s0, s1)
    left0, left1 = sub(rho_low, rho_high, along0, along1)
    near, far = next_distance(rho_low, rho_high, u0, u1, c0, c1)
    turned0, turned1 = atan2(aside0, aside1, left0, left1)
    return near, far, turned0, turned1


def next_distance(rho_low: float, rho_high: float, u0: float, u1: float, c0: float, c1: float) -> Bounds:
    """Bounds of sqrt(rho^2 - 2 rho u c + u^2) for u [m] in [u0, u1] and the cosine in [c0, c1].

    It is linear in c and convex in rho and in u: the largest value is at a corner. For rho > |u| it rises with rho, so
    the smallest is at rho_low, at an end of c, and at an end of u or at u = rho_low c, where rho^2 (1 - c^2) is left.
    """
    low, high = math.inf, 0.0
    for c in (c0, c1):
        for u in (u0, u1):
            least, other = _square(rho_low, u, c)
            _, most = _square(rho_high, u, c)
            low, high = min(low, least), max(high, most, other)
        best0, best1 = mul(rho_low, rho_low, c, c)
        if u0 <= best1 and best0 <= u1:
            _, c_square = sqr(c, c)
            square, _ = sqr(rho_low, rho_low)
            low = min(low, square * max(1.0 - c_square, 0.0))
    return sqrt(max(low, 0.0), max(high, 0.0))


def _square(rho: float, u: float, c: float) -> Bounds:
    """Bounds of rho^2 - 2 rho u c + u^2 [m^2] at a point."""
    p0, p1 = mul(rho, rho, u, u)
    p0, p1 = mul(2.0 * p0, 2.0 * p1, c, c)
    r0, r1 = sqr(rho, rho)
    s0, s1 = sqr(u, u)
    s0, s1 = add(r0, r1, s0, s1)
    return sub(s0, s1, p0, p1)
