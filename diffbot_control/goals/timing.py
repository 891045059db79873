"""Time of the controller: when poses arrived, and how long a goal may take. Times in seconds.

Time is counted, not compared: every event adds the time since the event before, between 0 and MAX_STEP. So a clock
that is set, or that restarts, neither ends a goal nor keeps it alive.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

from diffbot_core.data_sheet import DataSheet, fastest
from diffbot_core.stamps import S_PER_NS, Lateness, StampWatch

MAX_STEP = 1.0
"""[s] a longer time between two poses, or two events, counts as this long"""
_SLACK = 0.05
"""[s] by which stamps may run ahead of the time that has passed: the jitter of their arrival"""
_PERIODS, _FIRST_PERIOD = 15, 0.1
"""number of newest times between poses whose median is the period, and [s] the period before the second pose"""

_BASE_TIME = 120.0
"""[s] allowed for every goal, however near it is: to settle within the tolerances"""
_WAYPOINT_TIME = 30.0
"""[s] allowed for each further goal of a path"""
_GENEROSITY = 4.0
"""multiple of the shortest time that the limits of the data sheet allow"""
_MIN_PROGRESS_TIME = 30.0
"""[s] shortest time without progress after which a goal is given up"""
_REST_TIME = 60.0
"""[s] at rest near the goal without an answer, after which the goal is given up"""
_MIN_STEP, _MIN_SHARE = 0.05, 0.02
"""progress is a remaining distance smaller than the smallest one so far by this length [m], and by this share of it"""
_JUMP = 0.5
"""[m] If the estimate jumps away from the goal by more than this, restart the progress timer."""
_SLOWEST = 1e-3
"""[m/s], [rad/s] a robot with a lower limit must not move"""
_LONGEST, _ROUNDING = 1e6, 1e-6
"""[s] longest derived timeout, and by how much a sum of times may differ from the timeout"""


class PoseClock:
    """Follows the stamps of the poses, the caller's clock, and the steady clock (nan for callers without one)."""

    def __init__(self) -> None:
        """Start before the first pose."""
        self.is_simulated = False
        """the stamps are in simulated time, which may run slower or faster than the steady clock"""
        self.advances = False
        """True if the stamp of the newest pose was later than all earlier ones, the only sign of life of its sender"""
        self.silence = 0.0
        """[s] since the last pose whose stamp advanced, or since a later goal"""
        self.suspension = 0.0
        """[s] time between the last two events on the steady clock"""
        self._stamps, self._lateness = StampWatch(), Lateness()
        self._periods: deque[float] = deque(maxlen=_PERIODS)
        self._now = self._steady = math.nan
        self._since_pose = math.inf
        """[s] time since the last pose whose stamp advanced, on the caller's clock; inf before the first pose"""
        self._alive = math.nan
        """[s] time on the steady clock at which that pose would have arrived without an unusual delay"""
        self._stepped, self._credit, self._is_halted = math.nan, _SLACK, False
        """[s] steady time of the last step; [s] time left over for the next steps; True if zero was sent since then"""

    @property
    def has_pose(self) -> bool:
        """True after the first pose."""
        return self._since_pose < math.inf

    @property
    def period(self) -> float:
        """The median time [s] between two poses."""
        return sorted(self._periods)[len(self._periods) // 2] if self._periods else _FIRST_PERIOD

    def pass_time(self, now: float, steady: float) -> float:
        """Count the time since the last event and return it [s].

        Args:
            now: [s] on the caller's clock.
            steady: [s] on the steady clock; nan without one.
        """
        passed = now - self._now
        passed = min(max(passed, 0.0), MAX_STEP) if math.isfinite(passed) else 0.0
        self._now = now
        self.silence += passed
        self._since_pose += passed
        gap = steady - self._steady
        self.suspension, self._steady = (gap if gap > 0.0 else 0.0), steady
        return passed

    def on_pose(self, stamp: int) -> float:
        """Add the stamp [ns] of a pose that arrived at the time of the last :meth:`pass_time`.

        Returns:
            The time [s] that the step may use for the limits of acceleration, at most the time since the last step.
        """
        before, self.advances = self._stamps.newest, self._stamps.advances(stamp)
        if not self.advances:
            return 0.0
        dt = MAX_STEP if before is None else (stamp - before) * S_PER_NS
        if before is not None:
            self._periods.append(dt)
        late = 0.0
        if not self.is_simulated and not math.isnan(self._steady):
            late = self._lateness.next(stamp, self._steady)
        self._alive = self._steady - late if math.isnan(self._alive) else max(self._alive, self._steady - late)
        self.silence = self._since_pose = 0.0
        return self._limited(min(dt, MAX_STEP) if before is not None else 0.0)

    def on_goal(self) -> None:
        """Restart the time without a pose."""
        self.silence = 0.0

    def halt(self) -> None:
        """Note that zero was sent: the next step starts from rest, and may use no time that passed before."""
        self._is_halted = True

    def is_overdue(self, timeout: float, in_real_time: bool = True) -> bool:
        """Return True if the last pose is older than ``timeout`` [s]; False before the first pose.

        Args:
            timeout: [s].
            in_real_time: the age on the steady clock counts, too; otherwise only the age on the caller's clock.
        """
        if not self.has_pose:
            return False
        return self._since_pose > timeout or (in_real_time and self._steady - self._alive > timeout)

    def _limited(self, dt: float) -> float:
        """Return ``dt`` [s], cut to the time that has passed on the steady clock since the last step, and _SLACK."""
        passed = math.nan if self.is_simulated else self._steady - self._stepped
        self._stepped = self._steady
        if self._is_halted:
            self._is_halted, self._credit = False, 0.0
            return 0.0
        if not math.isnan(passed):
            allowed = max(passed, 0.0) + self._credit
            dt = min(dt, allowed)
            self._credit = min(allowed - dt, _SLACK)
        return dt


class Way(NamedTuple):
    """The remaining way to the last goal."""

    distance: float
    """[m] along the straight lines"""
    goals: int
    """number of goals that remain"""
    is_near: bool
    """the last goal is so near that the robot need not come closer"""
    is_at_rest: bool
    """the robot rests near the last goal"""


def _turn_and_start(sheet: DataSheet) -> float:
    """Return the time [s] of a whole turn, plus the time to reach and to leave the largest speeds."""
    v, omega = (max(limit, _SLOWEST) for limit in fastest(sheet))
    ramps = (
        0.0 if bound == math.inf else 2.0 * speed / bound
        for speed, bound in ((v, sheet.a_max), (omega, sheet.omega_dot_max))
    )
    return 2.0 * math.pi / omega + sum(ramps)


def derived_timeout(distance: float, goals: int, sheet: DataSheet) -> float:
    """Return the time [s] that the robot may take for a route of ``distance`` [m] through ``goals`` goals."""
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
    """Return the decrease [m] of the smallest remaining distance that counts as progress."""
    return max(_MIN_STEP, _MIN_SHARE * best)


class Patience:
    """Counts the time that a goal takes, and decides when the robot gives the goal up."""

    def __init__(self) -> None:
        """Start without a goal."""
        self.timeout = math.inf
        """[s] for the present goal; a derived timeout is for the whole path"""
        self.age = 0.0
        """[s] since the goal or path was accepted"""
        self._goal_age = 0.0
        """[s] since the robot turned to the present goal of the path"""
        self._option = 0.0
        """[s] value of goal_timeout from which the timeout was set"""
        self._is_final = False
        """the pose was known when the timeout was derived"""
        self._best = self._last = math.inf
        """[m] smallest remaining distance so far, and the newest"""
        self._was_near = False
        """the robot was near the last goal, where its manoeuvres need not bring it closer"""
        self._without_progress = self._at_rest = 0.0
        """[s] time without progress, and time at rest near the last goal"""

    def accept(
        self, option: float, distance: float, goals: int, sheet: DataSheet, is_final: bool, is_replanned: bool = False
    ) -> None:
        """Start to count for a new goal or path.

        Args:
            option: [s] goal_timeout; a negative value derives the timeout, 0 means no timeout.
            distance: [m] along the route.
            goals: number of goals of the route.
            sheet: limits of the robot.
            is_final: the pose of the robot is known; otherwise the timeout is derived again at the first step.
            is_replanned: the path leads to the same goal as the path before, so earlier progress still counts.
        """
        self.age = 0.0
        self.next_goal()
        if not is_replanned:
            self._without_progress = self._at_rest = 0.0
            self._best = self._last = math.inf
            self._was_near = False
        self._set_timeout(option, distance, goals, sheet)
        self._is_final = is_final

    def next_goal(self) -> None:
        """Turn to the next goal of the path: restart a given timeout; a derived one is for the whole path."""
        self._goal_age = 0.0

    def pass_time(self, passed: float) -> None:
        """Count ``passed`` [s], with a pose or without."""
        self.age += passed
        self._goal_age += passed

    def reason_of_time(self) -> str:
        """Return why the goal is given up if its timeout has passed; otherwise an empty text."""
        if (self.age if self._option < 0.0 else self._goal_age) < self.timeout - _ROUNDING:
            return ""
        derived = " (derived from distance and limits)" if self._option < 0.0 else ""
        return f"not reached within goal_timeout = {self.timeout:.3g} s{derived}"

    def reason_to_give_up(self, dt: float, way: Way, option: float, sheet: DataSheet) -> str:
        """Return why the present goal is given up after a step; empty if the robot goes on.

        Args:
            dt: [s] since the last step; a long gap between poses counts as a short time.
            way: the remaining way.
            option: [s] goal_timeout, which may have changed.
            sheet: limits of the robot.
        """
        if not self._is_final or option != self._option:
            self._set_timeout(option, way.distance, way.goals, sheet)
        # At the edge of the tolerances a noisy estimate alternates, so a step in motion only takes its own time away.
        self._at_rest = max(self._at_rest + (dt if way.is_at_rest else -dt), 0.0)
        if self._at_rest >= _REST_TIME:
            return f"at rest for {_REST_TIME:.0f} s without being within the tolerances, {way.distance:.2f} m to go"
        jumped = way.distance > self._last + _JUMP
        if jumped or self._best == math.inf or way.distance <= self._best - _step(self._best):
            self._best, self._without_progress = way.distance, 0.0
        else:
            self._without_progress += dt
        self._last = way.distance
        self._was_near = way.is_near or (self._was_near and not jumped)
        if self._without_progress < _MIN_PROGRESS_TIME:
            return ""
        allowed = max(progress_time(self._best, sheet), _BASE_TIME if self._was_near else 0.0)
        if self._without_progress >= allowed:
            return f"no progress for {allowed:.0f} s, {way.distance:.2f} m to go"
        return ""

    def _set_timeout(self, option: float, distance: float, goals: int, sheet: DataSheet) -> None:
        self._option, self._is_final = option, True
        self.timeout = derived_timeout(distance, goals, sheet) if option < 0.0 else option or math.inf
