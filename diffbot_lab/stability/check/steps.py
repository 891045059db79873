"""Where a step may lead: slices of what is measured, and the arc in Cartesian coordinates.

The robot stands at the origin and looks along x; the goal is at rho (cos alpha, sin alpha). A step with the rotation z
ends on the arc's chord, u (cos(z / 2), sin(z / 2)), with u = t_s v sinc(z / 2).
"""

from __future__ import annotations

import math
from typing import NamedTuple

from diffbot_lab.stability.check.commands import SLACK, Command, Numbers, Range, product, sinc_range

PI = math.pi + SLACK


class Box(NamedTuple):
    """True states, closed; angles of the end that leads."""

    r0: float
    """[m]"""
    r1: float
    a0: float
    """[rad]"""
    a1: float
    b0: float
    b1: float


class Slice(NamedTuple):
    """Part of what may be measured in a box; angles not wrapped."""

    possible: bool
    near: float
    """[m] measured distance"""
    far: float
    p: float
    """[rad] measured bearing"""
    q: float
    d0: float
    """[rad] by which the goal's direction is measured wrong"""
    d1: float


def bearing_error(loop: Numbers, rho: float) -> float:
    """Largest error [rad] of the goal's direction at a distance beyond ``eps_rho`` [m]."""
    return math.asin(min(loop.eps_rho / rho, 1.0)) + SLACK


def slice_count(loop: Numbers, box: Box, width: float) -> int:
    """Return into how many slices of at most ``width`` [rad] the measured bearing is cut."""
    return math.ceil((box.a1 - box.a0 + 2.0 * (bearing_error(loop, box.r0) + loop.eps_theta)) / width)


def slice_of(loop: Numbers, box: Box, part: int, parts: int) -> Slice:
    """Return one of the slices that together hold all that may be measured.

    Seen from the robot, the goal is measured somewhere in a disc of radius eps about itself. The line in a direction
    that is wrong by d meets the disc between two points whose distances have the product rho^2 - eps^2 and the sum
    2 rho cos(d). Both the near and the far one are between their values for the smallest |d| of the slice.
    """
    widest = bearing_error(loop, box.r0)
    low = box.a0 - widest - loop.eps_theta - SLACK
    step = (box.a1 - box.a0 + 2.0 * (widest + loop.eps_theta + SLACK)) / parts
    p, q = low + part * step - SLACK, low + (part + 1) * step + SLACK
    d0, d1 = max(p - box.a1 - loop.eps_theta, -widest) - SLACK, min(q - box.a0 + loop.eps_theta, widest) + SLACK
    off = 0.0 if d0 <= 0.0 <= d1 else min(abs(d0), abs(d1))
    aside = box.r0 * math.sin(off)
    half = math.sqrt(max(loop.eps_rho**2 - aside**2, 0.0)) + SLACK
    far = box.r1 * math.cos(off) + half + SLACK
    near = (box.r0**2 - loop.eps_rho**2) / (box.r0 * math.cos(off) + half) - SLACK
    return Slice(d0 <= d1, near, far, p, q, d0, d1)


def clipped(low: float, high: float, turns: int) -> Range:
    """Return the part of an interval of angles that is within +-pi after so many turns back; empty: low > high."""
    return max(low - 2.0 * math.pi * turns - SLACK, -PI), min(high - 2.0 * math.pi * turns + SLACK, PI)


def measured_as(loop: Numbers, box: Box, alpha: Range, turns: int) -> Box:
    """Return the states of a box whose bearing can be measured in a range after so many turns back; not empty."""
    reach = bearing_error(loop, box.r0) + loop.eps_theta + SLACK
    low, high = alpha[0] + 2.0 * math.pi * turns - reach, alpha[1] + 2.0 * math.pi * turns + reach
    return Box(box.r0, box.r1, min(max(box.a0, low), box.a1), max(min(box.a1, high), box.a0), box.b0, box.b1)


def with_beta(loop: Numbers, box: Box, one: Slice, turns: int) -> tuple[float, float, float, float]:
    """Return the part of a slice that has the measured beta within +-pi after so many turns back.

    Bounds of the error d of the goal's direction, and of the measured bearing with it; empty: the first low > high.
    """
    d0 = max(one.d0, (2 * turns - 1) * math.pi - box.b1 - SLACK)
    d1 = min(one.d1, (2 * turns + 1) * math.pi - box.b0 + SLACK)
    p, q = box.a0 + d0 - loop.eps_theta - SLACK, box.a1 + d1 + loop.eps_theta + SLACK
    return d0, d1, max(one.p, p), min(one.q, q)


def motion_of(loop: Numbers, command: Command) -> tuple[float, float, float, float]:
    """Bounds of the chord [m] and of the rotation [rad] of one step, each wheel off by its own error.

    The errors of the rims add up to half noise (|left| + |right|) in v, and to that over half in omega. This is convex
    in the command: it is largest at a corner.
    """
    v0, v1, w0, w1 = command
    error = 0.0
    for v in (v0, v1):
        for w in (loop.half * w0, loop.half * w1):
            error = max(error, 0.5 * loop.noise * (abs(v - w) + abs(v + w)))
    turned = error / loop.half + loop.eps_omega + SLACK
    error += SLACK
    z0, z1 = loop.t_s * (w0 - turned) - SLACK, loop.t_s * (w1 + turned) + SLACK
    u0, u1 = product((loop.t_s * (v0 - error), loop.t_s * (v1 + error)), sinc_range(0.5 * z0, 0.5 * z1))
    return u0, u1, z0, z1


def farthest_after(box: Box, u0: float, u1: float, z0: float, z1: float) -> float:
    """Largest distance [m] from the goal after a step.

    It is convex in rho and in the chord's vector: largest at an end of rho and of the chord's length, and at an end of
    its angle to the goal, or where it points away from the goal or at it.
    """
    a0, a1 = box.a0 - 0.5 * z1, box.a1 - 0.5 * z0
    farthest = 0.0
    for rho in (box.r0, box.r1):
        for u in (u0, u1):
            farthest = max(farthest, _distance(rho, u, a0), _distance(rho, u, a1))
            if a0 <= 0.0 <= a1:
                farthest = max(farthest, abs(rho - u))
            if a1 >= math.pi or a0 <= -math.pi:
                farthest = max(farthest, abs(rho + u))
    return farthest + SLACK


def _distance(rho: float, u: float, angle: float) -> float:
    return math.hypot(rho - u * math.cos(angle), u * math.sin(angle))


def nearest_after(box: Box, u0: float, u1: float, z0: float, z1: float) -> float:
    """Least distance [m] from the goal after a step that is shorter than r0: it rises with rho.

    For each length of the chord it is least at the largest or smallest cosine of the angle between chord and goal; for
    each angle, where the chord ends at the foot of the perpendicular, or at the end that is next to it.
    """
    a0, a1 = box.a0 - 0.5 * z1, box.a1 - 0.5 * z0
    nearest = math.inf
    for turn in range(-1, 4):
        # The ends, and the multiples of pi that are between them.
        angle = a0 if turn == 2 else a1 if turn == 3 else turn * math.pi
        if a0 - SLACK <= angle <= a1 + SLACK:
            foot = min(max(box.r0 * math.cos(angle), u0), u1)
            nearest = min(nearest, _distance(box.r0, foot, angle))
    return nearest - SLACK


def bearing_after(rho: float, alpha: float, u: float, z: float) -> float:
    """Return the goal's bearing [rad] after a step minus alpha, as seen with the heading before the step."""
    x, y = rho * math.cos(alpha) - u * math.cos(0.5 * z), rho * math.sin(alpha) - u * math.sin(0.5 * z)
    return math.atan2(y * math.cos(alpha) - x * math.sin(alpha), x * math.cos(alpha) + y * math.sin(alpha))


def turned_range(box: Box, u0: float, u1: float, z0: float, z1: float) -> Range:
    """Bounds of the turn of the goal's direction [rad].

    It is monotone in rho and in u while the angle between chord and goal is fixed. As that angle grows, the turn is at
    most asin(|u| / rho), which it reaches where the cosine is u / rho, and monotone elsewhere.
    """
    low, high = math.inf, -math.inf
    for rho in (box.r0, box.r1):
        for u in (u0, u1):
            for alpha, z in ((box.a0, z1), (box.a1, z0)):
                turned = bearing_after(rho, alpha, u, z)
                low, high = min(low, turned), max(high, turned)
    a0, a1 = box.a0 - 0.5 * z1, box.a1 - 0.5 * z0
    for u in (u0, u1):
        flat = math.asin(abs(u) / box.r0) + SLACK
        for turn in range(-2, 2):
            middle = (turn + 0.5) * math.pi
            if a0 <= middle + flat and middle - flat <= a1:
                # Forwards the goal turns to the left if it is there, backwards to the right.
                low, high = (low, max(high, flat)) if (turn % 2 == 0) == (u > 0.0) else (min(low, -flat), high)
    return low - SLACK, high + SLACK


def alpha_range(box: Box, u0: float, u1: float, z0: float, z1: float) -> Range:
    """Bounds of alpha [rad] after a step, not wrapped.

    For |u| < r0 / 2 it rises with alpha and falls with z: the goal's direction turns by less than |u| / (rho - |u|) < 1
    per radian of either. In rho and in u it is monotone.
    """
    low, high = math.inf, -math.inf
    for rho in (box.r0, box.r1):
        for u in (u0, u1):
            low = min(low, box.a0 + bearing_after(rho, box.a0, u, z1) - z1)
            high = max(high, box.a1 + bearing_after(rho, box.a1, u, z0) - z0)
    return low - SLACK, high + SLACK


def after(loop: Numbers, box: Box, u0: float, u1: float, z0: float, z1: float) -> Box:
    """Return bounds of the states after a step from a box; ``motion_of`` gives the chord, shorter than r0 / 2.

    The base may end beside the end of the chord: the goal's distance then changes by as much at most, and its direction
    by the angle of a tangent.
    """
    turned, alpha = turned_range(box, u0, u1, z0, z1), alpha_range(box, u0, u1, z0, z1)
    near, far = nearest_after(box, u0, u1, z0, z1), farthest_after(box, u0, u1, z0, z1)
    beside = loop.t_s * loop.eps_v
    angle = math.asin(beside / near) + SLACK if beside < near else PI
    return Box(
        near - beside - SLACK,
        far + beside + SLACK,
        alpha[0] - angle,
        alpha[1] + angle,
        box.b0 + turned[0] - angle,
        box.b1 + turned[1] + angle,
    )
