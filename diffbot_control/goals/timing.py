"""Time of the controller: age of the newest pose, and the guard that ends a goal that takes too long. Times in seconds.

All ages are sums of the times between events, each of which is limited to the range from 0 to MAX_STEP. So a clock that
is set or restarted neither ends a goal nor keeps it alive.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Sequence
from itertools import takewhile
from typing import NamedTuple

from diffbot_core.data_sheet import DataSheet, fastest
from diffbot_core.geometry import Pose
from diffbot_core.stamps import S_PER_NS, Lateness, StampWatch

MAX_STEP = 1.0
"""[s] largest time that is counted between two poses, or between two events"""
_SLACK = 0.05
"""[s] jitter of arrival: the time by which stamps may run ahead of the steady clock"""
_PERIODS, _FIRST_PERIOD = 15, 0.1
"""number of the newest times between poses, whose median is the period; [s] period before the second pose"""

_BASE_TIME = 120.0
"""[s] time allowed for every goal in addition to the motion, to settle within the tolerances"""
_WAYPOINT_TIME = 30.0
"""[s] time allowed for each further goal of a path in addition to the motion"""
_GENEROSITY = 4.0
"""allowed time for the motion as a multiple of the shortest time within the limits of the data sheet"""
_MIN_PROGRESS_TIME = 30.0
"""[s] lower bound of the time without progress after which a goal is given up"""
_REST_TIME = 60.0
"""[s] time at rest near the goal after which a goal that is not reached is given up"""
_MIN_PROGRESS, _MIN_SHARE = 0.05, 0.02
"""A remaining distance counts as progress if it is smaller than the smallest distance so far by this length [m] and by
this share."""
_JUMP = 0.5
"""[m] If the estimate jumps away from the goal by more than this, restart the progress timer."""
_MIN_COVERED = 0.05
"""share of the distance that the robot must cover before its mean speed so far is used"""
_SLOWEST = 1e-3
"""[m/s], [rad/s] a robot with a lower speed limit counts as one that must not move"""
_FASTEST = 10.0
"""[m/s], [rad/s] speed to which a robot without a speed limit is assumed to accelerate"""
_LONGEST, _ROUNDING = 1e6, 1e-6
"""[s] longest derived timeout; [s] rounding error of a sum of times"""


class PoseClock:
    """Measures the time between poses and since the newest pose.

    It uses the stamps of the poses, the caller's clock and a steady clock; a caller without a steady clock passes nan.
    """

    def __init__(self) -> None:
        """Start before the first pose."""
        self.is_simulated = False
        """True if the stamps are in simulated time, which may run slower or faster than the steady clock"""
        self.advances = False
        """True if the stamp of the newest pose was later than all earlier stamps; only such a pose is a sign of life"""
        self.silence = 0.0
        """[s] time since the last pose whose stamp advanced, or since the last new goal if it is newer"""
        self.suspension = 0.0
        """[s] time between the last two events, on the steady clock"""
        self._stamps, self._lateness = StampWatch(), Lateness()
        self._periods: deque[float] = deque(maxlen=_PERIODS)
        self._now = self._steady = math.nan
        self._since_pose = math.inf
        """[s] time since the last pose whose stamp advanced, on the caller's clock; inf before the first pose"""
        self._alive = math.nan
        """[s] steady time at which this pose would have arrived without its unusual delay"""
        self._last_step, self._credit, self._is_halted = math.nan, _SLACK, False
        """[s] steady time of the last step; [s] additional time for the next step; True if zero was sent since"""

    @property
    def has_pose(self) -> bool:
        """True after the first pose."""
        return self._since_pose < math.inf

    @property
    def period(self) -> float:
        """Median time [s] between two poses."""
        return sorted(self._periods)[len(self._periods) // 2] if self._periods else _FIRST_PERIOD

    def pass_time(self, now: float, steady: float) -> float:
        """Count the time since the last event and return it [s].

        Args:
            now: [s] time on the caller's clock.
            steady: [s] time on the steady clock; nan without one.
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
            The time [s] for which the acceleration limits apply in this step.
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
        """Record that zero was sent: the next step starts from rest, without time to accelerate."""
        self._is_halted = True

    def is_overdue(self, timeout: float, in_real_time: bool) -> bool:
        """Return True if the last pose is older than ``timeout`` [s]; False before the first pose.

        Args:
            timeout: [s] largest age of a pose.
            in_real_time: True to check the age on both clocks; False to check it on the caller's clock only.
        """
        if not self.has_pose:
            return False
        return self._since_pose > timeout or (in_real_time and self._steady - self._alive > timeout)

    def _limited(self, dt: float) -> float:
        """Limit ``dt`` [s] to the time that has passed on the steady clock since the last step, plus _SLACK."""
        passed = math.nan if self.is_simulated else self._steady - self._last_step
        self._last_step = self._steady
        if self._is_halted:
            self._is_halted, self._credit = False, 0.0
            return 0.0
        if not math.isnan(passed):
            allowed = max(passed, 0.0) + self._credit
            dt = min(dt, allowed)
            self._credit = min(allowed - dt, _SLACK)
        return dt


class RemainingPath(NamedTuple):
    """The rest of the path to the last goal."""

    distance: float
    """[m] length of the straight lines"""
    goals: int
    """number of goals that remain"""
    is_near: bool
    """True if the last goal is so near that manoeuvres need not reduce the distance"""
    is_at_rest: bool
    """True if the robot rests near the last goal"""


def distance_along(pose: Pose, goals: Iterable[Pose]) -> float:
    """Return the length [m] of the straight lines from ``pose`` through all ``goals``."""
    length, last = 0.0, pose
    for goal in goals:
        length += math.hypot(goal.x - last.x, goal.y - last.y)
        last = goal
    return length


def goals_passed(pose: Pose, goals: Sequence[Pose], radius: float) -> int:
    """Return how many goals, from the first on, are within ``radius`` [m] of a pose; the last goal never counts."""
    near = takewhile(lambda one: math.hypot(one.x - pose.x, one.y - pose.y) < radius, goals[:-1])
    return sum(1 for _ in near)


def distance_ahead(pose: Pose, goals: Sequence[Pose], radius: float) -> float:
    """Return the length [m] of the route from ``pose`` through the goals that :func:`goals_passed` does not count."""
    return distance_along(pose, goals[goals_passed(pose, goals, radius) :])


def _turn_and_start(sheet: DataSheet) -> float:
    """Return the time [s] for a full turn, and for accelerating to the largest speeds and braking from them."""
    v, omega = (max(limit, _SLOWEST) for limit in fastest(sheet))
    ramps = (
        0.0 if bound == math.inf else 2.0 * (speed if speed < math.inf else _FASTEST) / bound
        for speed, bound in ((v, sheet.a_max), (omega, sheet.omega_dot_max))
    )
    return 2.0 * math.pi / omega + sum(ramps)


def derived_timeout(distance: float, goals: int, sheet: DataSheet) -> float:
    """Return the time [s] allowed for a route of ``distance`` [m] through ``goals`` goals."""
    v = max(fastest(sheet)[0], _SLOWEST)
    shortest = distance / v + goals * _turn_and_start(sheet)
    return min(_BASE_TIME + (goals - 1) * _WAYPOINT_TIME + _GENEROSITY * shortest, _LONGEST)


def progress_time(distance: float, sheet: DataSheet) -> float:
    """Return the time [s] allowed without progress at a ``distance`` [m]; inf if the robot must not move."""
    v = fastest(sheet)[0]
    if v < _SLOWEST:
        return math.inf
    return max(_MIN_PROGRESS_TIME, _GENEROSITY * (_turn_and_start(sheet) + _least_progress(distance) / v))


def _least_progress(best: float) -> float:
    """Return by how much [m] a remaining distance must be smaller than ``best`` to count as progress."""
    return max(_MIN_PROGRESS, _MIN_SHARE * best)


def time_remaining(distance: float, first_distance: float, elapsed: float, max_speed: float) -> float:
    """Estimate the time [s] to the goal from the mean speed so far, or initially from the speed limit.

    Args:
        distance: [m] remaining distance.
        first_distance: [m] remaining distance when the goal was accepted.
        elapsed: [s] since the goal was accepted.
        max_speed: [m/s] speed limit; may be infinite, or 0 for a robot that must not move.
    """
    covered = first_distance - distance
    if covered > _MIN_COVERED * first_distance and elapsed > 0.0:
        return distance * elapsed / covered
    return distance / max_speed if max_speed > 0.0 else math.inf


class GoalGuard:
    """Decides when to give up a goal: after its timeout, without progress, or at rest near the goal."""

    def __init__(self) -> None:
        """Start without a goal."""
        self.timeout = math.inf
        """[s] timeout of the current goal; a derived timeout is for the whole path"""
        self.age = 0.0
        """[s] time since the goal or path was accepted"""
        self._goal_age = 0.0
        """[s] time since the current goal of the path became the next one"""
        self._option = 0.0
        """[s] goal_timeout when the timeout was set"""
        self._is_final = False
        """True if the pose was known when the timeout was derived"""
        self._best = self._last = math.inf
        """[m] smallest and newest remaining distance"""
        self._was_near = False
        """True if the robot has been near the last goal, where manoeuvres need not reduce the distance"""
        self._without_progress = self._at_rest = 0.0
        """[s] time without progress, and time at rest near the last goal"""

    def accept(
        self, option: float, distance: float, goals: int, sheet: DataSheet, is_final: bool, ahead: float
    ) -> None:
        """Start with a new goal or path.

        Args:
            option: [s] goal_timeout; a negative value derives the timeout, 0 means no timeout.
            distance: [m] length of the route.
            goals: number of goals of the route.
            sheet: limits of the robot.
            is_final: True if the pose is known; otherwise the timeout is derived again at the first step.
            ahead: if the previous path had the same last goal, the remaining distance [m] of the new path, which is no
                progress by itself, so that the progress timer continues; otherwise nan.
        """
        self.age = 0.0
        self.next_goal()
        if not math.isnan(ahead):
            if self._last < math.inf:
                self._best += ahead - self._last
                self._last = ahead
        else:
            self._without_progress = self._at_rest = 0.0
            self._best = self._last = math.inf
            self._was_near = False
        self._set_timeout(option, distance, goals, sheet)
        self._is_final = is_final

    def next_goal(self) -> None:
        """Begin the next goal of the path: a timeout that was not derived applies to each goal."""
        self._goal_age = 0.0

    def pass_time(self, passed: float) -> None:
        """Add the time ``passed`` [s] since the last event."""
        self.age += passed
        self._goal_age += passed

    def timeout_reason(self) -> str:
        """Return why the goal is given up if its timeout has passed; otherwise an empty string."""
        if (self.age if self._option < 0.0 else self._goal_age) < self.timeout - _ROUNDING:
            return ""
        derived = " (derived from distance and limits)" if self._option < 0.0 else ""
        return f"not reached within goal_timeout = {self.timeout:.3g} s{derived}"

    def reason_to_give_up(self, dt: float, path: RemainingPath, option: float, sheet: DataSheet) -> str:
        """Return why the current goal is given up after a step; empty if the robot continues.

        Args:
            dt: [s] since the last step, at most MAX_STEP.
            path: rest of the path.
            option: [s] goal_timeout, which may have changed.
            sheet: limits of the robot.
        """
        if not self._is_final or option != self._option:
            self._set_timeout(option, path.distance, path.goals, sheet)
        # Noise makes a resting robot move now and then, so motion reduces this time instead of resetting it.
        self._at_rest = max(self._at_rest + (dt if path.is_at_rest else -dt), 0.0)
        if self._at_rest >= _REST_TIME:
            return f"at rest for {_REST_TIME:.0f} s without being within the tolerances, {path.distance:.2f} m to go"
        jumped = path.distance > self._last + _JUMP
        if jumped or self._best == math.inf or path.distance <= self._best - _least_progress(self._best):
            self._best, self._without_progress = path.distance, 0.0
        else:
            self._without_progress += dt
        self._last = path.distance
        self._was_near = path.is_near or (self._was_near and not jumped)
        if self._without_progress < _MIN_PROGRESS_TIME:
            return ""
        allowed = max(progress_time(self._best, sheet), _BASE_TIME if self._was_near else 0.0)
        if self._without_progress >= allowed:
            return f"no progress for {allowed:.0f} s, {path.distance:.2f} m to go"
        return ""

    def _set_timeout(self, option: float, distance: float, goals: int, sheet: DataSheet) -> None:
        self._option, self._is_final = option, True
        self.timeout = derived_timeout(distance, goals, sheet) if option < 0.0 else option or math.inf
