"""How far aside the way out of the finish can lead: the states (y, theta) that its steps can reach, cell by cell.

The robot reverses along the goal's axis, slowed down by what its heading is off, and turns to the heading LINE_GAIN y,
at most OUT_HEADING. How far out it is does not matter: its speed is anything from OUT_SPEED down to what it is where
the way ends.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from diffbot_control.law.finish import LINE_GAIN, OUT_HEADING, OUT_SPEED
from diffbot_core.errors import DiffbotError
from diffbot_lab.stability.interval.compiled import compile_bounds
from diffbot_lab.stability.tuned.check.commands import SLACK, Command, Numbers, Range, product, signed_profile
from diffbot_lab.stability.tuned.check.steps import motion_of

_HIGH, _WIDE = 0.004, 0.008
"""[m], [rad] sizes of the cells"""
_SPARE = 0.2
"""[m], [rad] of cells beyond the states that the way begins with"""


def turn_rate_range(loop: Numbers, theta: Range, heading: Range) -> Range:
    """Bounds of omega [rad/s] that turns a measured heading to another one."""
    low = signed_profile(theta[0] - heading[1], loop.hold_brake, loop.hold_react, loop.omega_max)
    high = signed_profile(theta[1] - heading[0], loop.hold_brake, loop.hold_react, loop.omega_max)
    return -high - SLACK, -low + SLACK


def heading_range(loop: Numbers, y: Range) -> Range:
    """Bounds of the heading [rad] that the robot turns to while it reverses."""
    low, high = LINE_GAIN * (y[0] - loop.eps_xy), LINE_GAIN * (y[1] + loop.eps_xy)
    return min(max(low, -OUT_HEADING), OUT_HEADING) - SLACK, min(max(high, -OUT_HEADING), OUT_HEADING) + SLACK


def after_step(loop: Numbers, y: Range, theta: Range, heading: Range, slowest: float) -> tuple[Range, Range]:
    """Return bounds of y [m] and theta [rad] after a step of the way out.

    Args:
        loop: law, contract and plant.
        y: [m] true.
        theta: [rad] true, within +-1.
        heading: [rad] that is turned to.
        slowest: [m/s] least speed backwards of a robot that need not turn; < 0 forwards.
    """
    measured = theta[0] - loop.eps_theta - SLACK, theta[1] + loop.eps_theta + SLACK
    w0, w1 = turn_rate_range(loop, measured, heading)
    low, high = measured[0] - heading[1], measured[1] - heading[0]
    least, most = (0.0 if low <= 0.0 <= high else min(abs(low), abs(high))), max(abs(low), abs(high))
    fastest = OUT_SPEED * max(1.0 - least / (2.0 * OUT_HEADING), 0.0) + SLACK
    slowest = min(slowest, loop.v_max, max(loop.rim - loop.half * max(abs(w0), abs(w1)) - SLACK, 0.0))
    slowest *= max(1.0 - (most if slowest > 0.0 else least) / (2.0 * OUT_HEADING), 0.0)
    u0, u1, z0, z1 = motion_of(loop, Command(-fastest, SLACK - slowest, w0, w1))
    # The sine rises within a quarter turn.
    sines = math.sin(theta[0] + 0.5 * z0) - SLACK, math.sin(theta[1] + 0.5 * z1) + SLACK
    aside = product((u0, u1), sines)
    return (y[0] + aside[0] - SLACK, y[1] + aside[1] + SLACK), (theta[0] + z0 - SLACK, theta[1] + z1 + SLACK)


def reach_all(loop: Numbers, slowest: float, cells: Any) -> bool:
    """Add all cells of (y, theta) that may be reached to those marked; return False if they do not suffice."""
    rows, columns = cells.shape
    waiting = [(i, j) for i in range(rows) for j in range(columns) if cells[i, j]]
    while len(waiting) > 0:
        i, j = waiting.pop()
        y = (i - rows // 2) * _HIGH - SLACK, (i + 1 - rows // 2) * _HIGH + SLACK
        theta = (j - columns // 2) * _WIDE - SLACK, (j + 1 - columns // 2) * _WIDE + SLACK
        after_y, after_theta = after_step(loop, y, theta, heading_range(loop, y), slowest)
        i0, i1 = math.floor(after_y[0] / _HIGH) + rows // 2, math.floor(after_y[1] / _HIGH) + rows // 2
        j0, j1 = math.floor(after_theta[0] / _WIDE) + columns // 2, math.floor(after_theta[1] / _WIDE) + columns // 2
        if i0 < 0 or j0 < 0 or i1 >= rows or j1 >= columns:
            return False
        for row in range(i0, i1 + 1):
            for column in range(j0, j1 + 1):
                if not cells[row, column]:
                    cells[row, column] = 1
                    waiting.append((row, column))
    return True


_reach_kernel = compile_bounds(reach_all)


def farthest_aside(loop: Numbers, lateral: float, heading: float, slowest: float) -> float:
    """Largest lateral error [m] on a way out, the first step included.

    Args:
        loop: law, contract and plant.
        lateral: [m] true lateral error at the beginning, at most.
        heading: [rad] true heading at the beginning, at most.
        slowest: [m/s] > 0 speed at the end of the way, at least.

    Raises:
        DiffbotError: if it is not bounded by these cells.
    """
    if heading + OUT_HEADING + _SPARE > 1.0:
        raise DiffbotError("not verified: the way out of the finish may begin with too large a heading")
    # In the first step the end of the way may be behind the robot, as measured; from then on that ends the way.
    (_, y), (_, theta) = after_step(
        loop, (-lateral, lateral), (-heading, heading), (-OUT_HEADING, OUT_HEADING), -OUT_SPEED
    )
    y, theta = max(y, lateral), max(theta, heading)
    top, side = math.ceil(y / _HIGH), math.ceil(theta / _WIDE)
    rows, columns = top + math.ceil(_SPARE / _HIGH), side + math.ceil(_SPARE / _WIDE)
    cells = np.zeros((2 * rows, 2 * columns), np.uint8)
    cells[rows - top : rows + top, columns - side : columns + side] = 1
    if not _reach_kernel(loop, slowest, cells):
        raise DiffbotError("not verified: the way out of the finish does not keep to the axis under this noise")
    used = np.flatnonzero(cells.any(axis=1))
    return float(_HIGH * max(rows - used[0], used[-1] + 1 - rows)) + SLACK
