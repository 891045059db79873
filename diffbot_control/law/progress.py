"""How long a goal may take, and whether the robot comes closer to it: pure functions for any law. Times in seconds."""

from __future__ import annotations

import math
from typing import NamedTuple

from diffbot_core.data_sheet import DataSheet, rim_speed

_BASE_TIME = 120.0
"""[s] of every goal: to settle within the tolerances, however near it is"""
_WAYPOINT_TIME = 30.0
"""[s] of each further goal of a path, which is reached before the next one"""
_GENEROSITY = 4.0
"""Times the time that the limits of the data sheet allow."""
_MIN_PROGRESS_TIME = 30.0
"""[s]"""
_MIN_STEP, _MIN_SHARE = 0.05, 0.02
"""[m] and share of the smallest remaining distance by which a new one has to be smaller"""
_JUMP = 0.5
"""[m] An estimate that was corrected by more, away from the goal, begins anew."""
_SLOWEST = 1e-3
"""[m/s], [rad/s] a lower limit means that the robot is kept standing"""
_LONGEST = 1e6
"""[s]"""


class Progress(NamedTuple):
    """Memory of the watch; the default is that of a new goal."""

    best: float = math.inf
    """[m] smallest remaining distance so far, or the one from which the next step counts"""
    last: float = math.inf
    """[m] newest remaining distance"""
    time: float = 0.0
    """[s] since a step was made"""
    uncertain: float = 0.0
    """[s] at rest with an estimate too uncertain for an answer"""


def _limits(sheet: DataSheet) -> tuple[float, float]:
    """Return the largest speed [m/s] and rotation on the spot [rad/s]."""
    rim = rim_speed(sheet)
    return min(sheet.v_max, rim), min(sheet.omega_max, 2.0 * rim / sheet.wheels.wheel_separation)


def _turn_and_start(sheet: DataSheet) -> float:
    """Return the time [s] of a whole turn, and to reach both speeds and leave them, at the limits."""
    v, omega = (max(limit, _SLOWEST) for limit in _limits(sheet))
    ramps = (
        0.0 if bound == math.inf else 2.0 * speed / bound
        for speed, bound in ((v, sheet.a_max), (omega, sheet.omega_dot_max))
    )
    return 2.0 * math.pi / omega + sum(ramps)


def derived_timeout(distance: float, goals: int, sheet: DataSheet) -> float:
    """Return the time [s] after which a goal is given up.

    Args:
        distance: [m] along the route.
        goals: number of goals of the route.
        sheet: limits of the robot.
    """
    v = max(_limits(sheet)[0], _SLOWEST)
    fastest = distance / v + goals * _turn_and_start(sheet)
    return min(_BASE_TIME + (goals - 1) * _WAYPOINT_TIME + _GENEROSITY * fastest, _LONGEST)


def progress_time(distance: float, sheet: DataSheet) -> float:
    """Return the time [s] within which the remaining ``distance`` [m] has to shrink; inf if the robot must not move."""
    v = _limits(sheet)[0]
    if v < _SLOWEST:
        return math.inf
    return max(_MIN_PROGRESS_TIME, _GENEROSITY * (_turn_and_start(sheet) + _step(distance) / v))


def _step(best: float) -> float:
    return max(_MIN_STEP, _MIN_SHARE * best)


def with_distance(memory: Progress, remaining: float, dt: float, is_near: bool) -> Progress:
    """Add a remaining distance [m] along the route, ``dt`` [s] after the last; near the goal no progress is asked."""
    jumped = remaining > memory.last + _JUMP
    if is_near or jumped or memory.best == math.inf or remaining <= memory.best - _step(memory.best):
        return memory._replace(best=remaining, last=remaining, time=0.0)
    return memory._replace(last=remaining, time=memory.time + dt)


def with_uncertainty(memory: Progress, dt: float, is_uncertain: bool) -> Progress:
    """Add ``dt`` [s] at rest with an estimate that is too uncertain, or not; an estimate at the edge may do both."""
    return memory._replace(uncertain=max(memory.uncertain + (dt if is_uncertain else -dt), 0.0))
