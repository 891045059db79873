"""How long a goal may take, and whether the robot comes closer to it, for any law. Times in seconds."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

from diffbot_core.data_sheet import DataSheet, fastest
from diffbot_core.units import S_PER_NS

_BASE_TIME = 120.0
"""[s] of every goal: to settle within the tolerances, however near it is"""
_WAYPOINT_TIME = 30.0
"""[s] of each further goal of a path, which is reached before the next one"""
_GENEROSITY = 4.0
"""Times the time that the limits of the data sheet allow."""
_MIN_PROGRESS_TIME = 30.0
"""[s]"""
_UNCERTAIN_TIME = 60.0
"""[s] at rest with an estimate too uncertain for an answer, after which that is the answer"""
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


class Way(NamedTuple):
    """What is left of the way to the last goal."""

    distance: float
    """[m] along the straight lines"""
    goals: int
    is_near: bool
    """so near the last goal that the robot need not come closer"""
    is_uncertain: bool
    """the robot rests, with an estimate too uncertain for an answer"""
    smallest_tolerance: Callable[[], tuple[float, float]]
    """[m], [rad] that the estimate allows"""


def _turn_and_start(sheet: DataSheet) -> float:
    """Return the time [s] of a whole turn, and to reach both speeds and leave them, at the limits."""
    v, omega = (max(limit, _SLOWEST) for limit in fastest(sheet))
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
    v = max(fastest(sheet)[0], _SLOWEST)
    least = distance / v + goals * _turn_and_start(sheet)
    return min(_BASE_TIME + (goals - 1) * _WAYPOINT_TIME + _GENEROSITY * least, _LONGEST)


def progress_time(distance: float, sheet: DataSheet) -> float:
    """Return the time [s] within which the remaining ``distance`` [m] has to shrink; inf if the robot must not move."""
    v = fastest(sheet)[0]
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


class Patience:
    """How long the present goal may take, by the stamps of the poses, and why it is given up."""

    def __init__(self) -> None:
        """Start without a goal."""
        self.timeout = math.inf
        """[s] for the present goal; if it is derived, for the whole path"""
        self.progress = Progress()
        self._option = 0.0
        """[s] the parameter that the timeout is from"""
        self._is_final = False
        """the timeout was derived with a known pose"""
        self._began: int | None = None
        """[ns] stamp of the first step"""

    def accept(self, option: float, distance: float, goals: int, sheet: DataSheet, is_final: bool) -> None:
        """Begin with a goal or a path.

        Args:
            option: [s] goal_timeout; negative: derived, 0: none.
            distance: [m] along the route.
            goals: number of goals of the route.
            sheet: limits of the robot.
            is_final: the distance is from a known pose; otherwise it is asked again at the first step.
        """
        self._began = None
        self.progress = Progress()
        self._set_timeout(option, distance, goals, sheet)
        self._is_final = is_final

    def _set_timeout(self, option: float, distance: float, goals: int, sheet: DataSheet) -> None:
        self._option, self._is_final = option, True
        self.timeout = derived_timeout(distance, goals, sheet) if option < 0.0 else option or math.inf

    def next_goal(self) -> None:
        """Go on with the next goal of the path; a timeout that was given counts anew, a derived one goes on."""
        self.progress = Progress()
        if self._option > 0.0:
            self._began = None

    def whole_timeout(self, goals: int) -> float:
        """Return the time [s] within which all ``goals`` of the route have to be reached."""
        return self.timeout * (max(goals, 1) if self._option > 0.0 else 1)

    def reason_to_give_up(self, stamp: int, dt: float, way: Way, option: float, sheet: DataSheet) -> str:
        """Return why the present goal is given up, empty if it is not.

        Args:
            stamp: [ns] of this step.
            dt: [s] since the last one.
            way: what is left.
            option: [s] goal_timeout, which may have changed.
            sheet: limits of the robot.
        """
        if self._began is None:
            self._began = stamp
        if not self._is_final or option != self._option:
            self._set_timeout(option, way.distance, way.goals, sheet)
        if self.timeout <= (stamp - self._began) * S_PER_NS:
            return self.timeout_reason()
        self.progress = with_distance(self.progress, way.distance, dt, way.is_near)
        self.progress = with_uncertainty(self.progress, dt, way.is_uncertain)
        if self.progress.uncertain >= _UNCERTAIN_TIME:
            xy, theta = way.smallest_tolerance()
            return f"the estimate is too uncertain: smallest possible tolerance {xy:.3g} m and {theta:.3g} rad"
        allowed = progress_time(self.progress.best, sheet)
        if self.progress.time >= allowed:
            return f"no progress for {allowed:.0f} s, {way.distance:.2f} m to go"
        return ""

    def timeout_reason(self) -> str:
        """Say that the time is over."""
        derived = " (derived from distance and limits)" if self._option < 0.0 else ""
        return f"not reached within goal_timeout = {self.timeout:.3g} s{derived}"
