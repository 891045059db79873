"""The controller's states: goals and paths, missing poses, coming to rest. Free of ROS; times in seconds."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from diffbot_control.law import goal_record
from diffbot_control.law import progress as watch
from diffbot_control.law.configuration import Report
from diffbot_control.law.controller import SwitchingLaw
from diffbot_control.law.driver import STOP, LawError, driver_of, scaled_uncertainty
from diffbot_control.law.goal_checker import GoalTolerance, is_at_rest, smallest_tolerance
from diffbot_control.law.goal_record import ANONYMOUS, GoalBook, GoalRequest, distance_along
from diffbot_control.law.limits import is_beyond
from diffbot_control.law.progress import Progress
from diffbot_control.law.protocol import Law
from diffbot_control.law.step_clock import StepClock
from diffbot_control.law.supervisor_config import SupervisorConfig as SupervisorConfig  # noqa: PLC0414 - re-exported
from diffbot_core.data_sheet import UNLIMITED, DataSheet
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist
from diffbot_core.stamps import StampWatch
from diffbot_core.uncertainty import CERTAIN, Estimate, Uncertainty
from diffbot_core.units import S_PER_NS

IDLE = "idle"
WAITING = "waiting for pose"
DRIVING = "driving"
REACHED = "goal reached"
UNCERTAIN = "tolerance below uncertainty"
STALE = "stale pose"
NOT_REACHED = "goal not reached"
STATES = (IDLE, WAITING, DRIVING, REACHED, UNCERTAIN, STALE, NOT_REACHED)
"""All messages of ~/status."""

_MAX_STEP = 1.0
"""[s] a longer gap between poses counts as this long for the acceleration limits."""
_NEAR_TOLERANCES = 3.0
"""Tolerances from the last goal within which the robot need not come closer."""
_UNCERTAIN_TIME = 60.0
"""[s] at rest with an estimate too uncertain for an answer, after which that is the answer"""
_STOP_REPEATS = 5
"""Zero commands sent after a stop, so that one lost message does not leave the robot driving."""


class _StepInput(NamedTuple):
    """What the newest step started from, so that it can be repeated with a corrected pose."""

    memory: Any
    """of the law"""
    dt: float
    """[s]"""
    command: Twist
    """the one before"""
    progress: Progress


class Supervisor:
    """Turns goals, poses and the passing of time into commands; each method returns the command to send, or None."""

    def __init__(self, config: SupervisorConfig, law: Law = SwitchingLaw) -> None:
        """Start idle; ``config.controller`` is a configuration of ``law``, which may raise LawError if it is unfit."""
        self.config = config
        self._driver = driver_of(law)
        self.memory: Any = self._driver.new_memory(config.controller)
        """of the law"""
        self.goal: Pose | None = None
        self.goals = GoalBook()
        """which goals were accepted, and how each ended"""
        self.state = IDLE
        self.report: Report | None = None
        self.reason = ""
        """why the last goal was not reached; empty if it was, or is still driven to"""
        self.has_failed = False
        """the last goal was given up because of an error: the law's or the node's own"""
        self.goals_reached = 0
        """goals reached so far; one that is lost and reached again, or held through silence, counts once"""
        self.waypoint = 0
        """number of the present goal in its path, from 1; 0 for a single goal"""
        self.waypoints = 0
        """goals of the path"""
        self.uncertainty = CERTAIN
        """of the newest pose"""
        self._route: list[Pose] = []
        self._counted = False
        """the present goal is among goals_reached"""
        self.accepted = 0
        """goals and paths accepted so far"""
        self.timeout = math.inf
        """[s] within which the present goal, or under a derived goal_timeout the whole path, has to be reached"""
        self._timeout_option = config.goal_timeout
        """the parameter that the timeout is from"""
        self._is_timeout_final = False
        """the timeout was derived with a known pose"""
        self._progress = Progress()
        self._goal_stamp: int | None = None
        """[ns] of the first pose with the present goal"""
        self._stamps = StampWatch()
        self.pose: Pose | None = None
        self._answer: Twist | None = None
        """to the newest pose"""
        self._command = STOP
        """the last one"""
        self._step_input: _StepInput | None = None
        self._step_clock = StepClock()
        self._last_pose_time: float | None = None
        """[s] of the newest pose whose stamp advanced"""
        self._silent_since = 0.0
        """[s] of that pose, or of a goal after it"""
        self._zeros_due = 0

    def on_goal(self, goal: Pose, request: GoalRequest = ANONYMOUS) -> None:
        """Drive to ``goal`` (frame of the poses) from the next pose on; the newest goal or path wins."""
        self._accept(request)
        self._route = []
        self.waypoint = self.waypoints = 0
        self._answer = None
        self._drive_to(goal)
        self._set_timeout()

    def on_path(self, goals: list[Pose], request: GoalRequest = ANONYMOUS) -> None:
        """Drive to ``goals`` one after the other (at least one); the last one is held."""
        self._accept(request)
        self.waypoint, self.waypoints = 1, len(goals)
        self._route = goals[1:]
        self._answer = None
        self._drive_to(goals[0])
        self._set_timeout()

    def _accept(self, request: GoalRequest) -> None:
        self.goals.accept(request)
        self._silent_since = request.time
        self.accepted += 1
        self._goal_stamp = None

    def _set_timeout(self) -> None:
        """Set how long the present goal may take, from acceptance on; again when the first pose is known."""
        timeout, sheet = self.config.goal_timeout, self._data_sheet()
        self._timeout_option = timeout
        self._is_timeout_final = self.pose is not None
        if timeout >= 0.0:
            self.timeout = timeout or math.inf
            return
        goals = self.goals_ahead
        distance = distance_along(self.pose or goals[0], goals) if goals else 0.0
        self.timeout = watch.derived_timeout(distance, len(goals), sheet)

    def _data_sheet(self) -> DataSheet:
        """Return the limits of the law's configuration; those of a law without any are the defaults."""
        sheet = getattr(self.config.controller, "data_sheet", None)
        return sheet if isinstance(sheet, DataSheet) else DataSheet()

    def _tolerance(self) -> GoalTolerance:
        tolerance = getattr(self.config.controller, "tolerance", None)
        return tolerance if isinstance(tolerance, GoalTolerance) else GoalTolerance()

    def distance_remaining(self) -> float:
        """Return the length [m] of the straight lines to the goal, or through what is left of the path; 0 if idle."""
        if self.goal is None or self.pose is None:
            return 0.0
        return distance_along(self.pose, (self.goal, *self._route))

    @property
    def poses_remaining(self) -> int:
        """Goals of the path that are not passed yet, the present one included; 0 if idle."""
        return 0 if self.goal is None else 1 + len(self._route)

    @property
    def goals_ahead(self) -> list[Pose]:
        """The goals that :attr:`poses_remaining` counts, in their order."""
        return [] if self.goal is None else [self.goal, *self._route]

    @property
    def is_beyond_limits(self) -> bool:
        """True if the last command exceeds a bound: it was lowered while driving, and the robot still brakes."""
        sheet = getattr(self.config.controller, "data_sheet", None)
        return isinstance(sheet, DataSheet) and is_beyond(self._command, sheet)

    def _drive_to(self, goal: Pose) -> None:
        self.goal = goal
        self._step_input = None
        self.state = WAITING if self._last_pose_time is None else DRIVING
        self.report = None
        self.reason = ""
        self.has_failed = False
        self._counted = False
        self._progress = Progress()
        if self.config.goal_timeout > 0.0:
            # Of each goal of a path.
            self._goal_stamp = None
        try:
            self.memory = self._driver.memory_for_new_goal(self.memory, self.config.controller)
        except LawError as error:
            self.give_up(str(error), has_failed=True)

    def on_cancel(self) -> Twist | None:
        """Drop the goal, if there is one, and start to come to rest at once, with or without a pose."""
        if self.goal is None:
            return None
        self._go_idle(IDLE)
        self.waypoint = self.waypoints = 0
        self.goals.cancel()
        if self._last_pose_time is None:
            self.goals.close_cancelled()
        return None if self.config.publish_when_idle else self._come_to_rest(0.0)

    def on_pose(
        self,
        stamp: int,
        now: float,
        pose: Pose,
        uncertainty: Uncertainty = CERTAIN,
        steady: float = math.nan,
    ) -> Twist | None:
        """Answer a pose. Only one whose stamp advances is a sign of life; a repeated one may correct the last step.

        Args:
            stamp: [ns] time the pose belongs to.
            now: [s] time of arrival, on the clock of :meth:`on_tick`.
            pose: in the frame of the goals.
            uncertainty: of the pose; by default the pose is assumed exact.
            steady: [s] the same on the steady clock; nan in simulated time, whose stamps are as good as their clock.
        """
        before, advances, dt = self._stamps.newest, self._stamps.advances(stamp), 0.0
        if advances:
            dt = 0.0 if before is None else min((stamp - before) * S_PER_NS, _MAX_STEP)
            dt = self._step_clock.limited(dt, steady)
            self._last_pose_time = self._silent_since = now
        self.goals.now = now
        same_step, same_pose = stamp == before, pose == self.pose
        if self.goal is None:
            self.pose = pose
            return self._come_to_rest(dt)
        if self._is_held and self._is_elsewhere(pose):
            self.pose = pose
            return self._come_to_rest(dt)
        if not advances and (self.state == STALE or self._is_overdue(now)):
            # The sender repeats itself, and the robot may be anywhere by now.
            return STOP
        if stamp != self._stamps.newest and self._answer is not None:
            # Out of order: a newer pose is answered already.
            return self._answer
        self.pose = pose
        if same_step and self._answer is not None:
            # A pose that is sent again, as in lock-step after a stall, is not a new step: the answer is the same.
            if same_pose:
                return self._answer
            # A pose corrected by a fix that came after the odometry: repeat the step with it.
            if self._step_input is not None:
                self.memory, dt, self._command, self._progress = self._step_input
        self.uncertainty = uncertainty
        self._answer = self._take_step(self.goal, pose, dt)
        return self._answer

    def _take_step(self, goal: Pose, pose: Pose, dt: float) -> Twist:
        self._step_input = _StepInput(self.memory, dt, self._command, self._progress)
        estimate = Estimate(pose, self.uncertainty)
        try:
            self.memory, command, self.report = self._driver.step(
                self.memory, estimate, goal, dt, self.config.controller
            )
        except LawError as error:
            self.give_up(str(error), has_failed=True)
            return self._come_to_rest(dt) or STOP
        self.memory, command = self._driver.limited(self.memory, command, self._command, dt, self.config.controller)
        self._command = command
        self.state = self._state_of_drive(command)
        reached = self.memory.reached
        if reached and not self._counted:
            self._counted = True
            self.goals_reached += 1
            if not self._route:
                self.goals.close(goal_record.REACHED)
            if not self.config.hold_goal and not self._route:
                self._go_idle(REACHED)
        if self._route and (reached or self.report.rho < self.config.waypoint_radius):
            self.waypoint += 1
            self._drive_to(self._route.pop(0))
        elif not self._counted:
            reason = self._reason_to_give_up(dt)
            if reason:
                self.give_up(reason)
        return command

    def _reason_to_give_up(self, dt: float) -> str:
        """Return why the present goal is given up ``dt`` [s] after the last step, empty if it is not."""
        stamp = self._stamps.newest
        if stamp is None or self.report is None:
            return ""
        if self._goal_stamp is None:
            self._goal_stamp = stamp
        if not self._is_timeout_final or self._timeout_option != self.config.goal_timeout:
            self._set_timeout()
        if self.timeout <= (stamp - self._goal_stamp) * S_PER_NS:
            return self._timeout_reason()
        return self._reason_of_no_progress(dt) or self._driver.reason_to_give_up(self.memory, self.config)

    def _timeout_reason(self) -> str:
        derived = " (derived from distance and limits)" if self.config.goal_timeout < 0.0 else ""
        return f"not reached within goal_timeout = {self.timeout:.3g} s{derived}"

    def _reason_of_no_progress(self, dt: float) -> str:
        """Return why the goal cannot be reached from here, empty if it may."""
        remaining, tolerance = self.distance_remaining(), self._tolerance().xy_goal_tolerance
        is_near = not self._route and remaining <= _NEAR_TOLERANCES * tolerance
        self._progress = watch.with_distance(self._progress, remaining, dt, is_near)
        self._progress = watch.with_uncertainty(self._progress, dt, self.state == UNCERTAIN)
        if self._progress.uncertain >= _UNCERTAIN_TIME:
            xy, theta = self.smallest_tolerance()
            return f"the estimate is too uncertain: smallest possible tolerance {xy:.3g} m and {theta:.3g} rad"
        allowed = watch.progress_time(self._progress.best, self._data_sheet())
        if self._progress.time >= allowed:
            return f"no progress for {allowed:.0f} s, {remaining:.2f} m to go"
        return ""

    @property
    def _is_held(self) -> bool:
        """The goal was reached and has been answered."""
        return self.goal is not None and self._counted and not self._route

    def _is_elsewhere(self, pose: Pose) -> bool:
        """Let a held goal go if the robot is found too far away; return whether it is."""
        if self.goal is None:
            return False
        bound = max(self.config.hold_distance, 2.0 * self._tolerance().xy_goal_tolerance)
        found = math.hypot(pose.x - self.goal.x, pose.y - self.goal.y)
        if found > bound:
            self._let_go(f"found {found:.2f} m from the held goal: hold_distance = {bound:g} m")
        return found > bound

    def _let_go(self, reason: str) -> None:
        """End the holding of a goal that was reached."""
        self.reason = reason
        self._go_idle(IDLE)

    def _state_of_drive(self, command: Twist) -> str:
        if self.memory.reached:
            return DRIVING if self._corrects(command) else REACHED
        config = self.config.controller
        uncertain = self._driver.is_too_uncertain(self.memory, command, self.uncertainty, config)
        return UNCERTAIN if uncertain else DRIVING

    def _corrects(self, command: Twist) -> bool:
        """True if the robot has left a reached goal and drives back."""
        if not self._counted or self.report is None:
            return False
        tolerance = self._tolerance()
        sheet = getattr(self.config.controller, "data_sheet", UNLIMITED)
        return not is_at_rest(command, tolerance, sheet) and self.report.rho > tolerance.xy_goal_tolerance

    def smallest_tolerance(self) -> tuple[float, float]:
        """Position [m] and heading [rad] tolerance that the present uncertainty allows this project's law at best."""
        controller = self.config.controller
        return smallest_tolerance(controller.tolerance, scaled_uncertainty(self.uncertainty, controller))

    def on_tick(
        self, now: float, silence: float = math.inf, is_stale: bool = False, elapsed: float = 0.0
    ) -> Twist | None:
        """Watch for missing poses: zero if the robot may be moving and ``is_stale``, or no pose for ``pose_timeout``.

        Args:
            now: [s] on the clock of :meth:`on_pose`.
            silence: [s] since the last pose by a clock that neither jumps nor runs fast; a goal is given up only if it
                is too long as well.
            is_stale: the robot must not move, whatever ``now`` says.
            elapsed: [s] since the present goal was accepted, by that clock.
        """
        self.goals.now = now
        self._watch_for_loss(now, silence)
        if self.goals.present is not None and self.goal is not None and elapsed >= self._whole_timeout():
            self.give_up(self._timeout_reason())
        if self._last_pose_time is None or (self.goal is None and self._zeros_due == 0):
            return None
        # Time that runs backwards (a restarted simulation) must not disable the timeout.
        self._last_pose_time = min(self._last_pose_time, now)
        if not is_stale and not self._is_overdue(now):
            return None
        self.memory = self._driver.halted(self.memory)
        self._command = STOP
        self._step_clock.halt()
        self.goals.close_cancelled()
        if self.goal is None:
            self._zeros_due -= 1
        else:
            self.state = STALE
        return STOP

    def _is_overdue(self, now: float) -> bool:
        return self._last_pose_time is not None and now - self._last_pose_time > self.config.pose_timeout

    def _watch_for_loss(self, now: float, silence: float) -> None:
        """Give the goal up if no pose has come for ``pose_lost_timeout``, or no longer hold it."""
        self._silent_since = min(self._silent_since, now)
        timeout = self.config.pose_lost_timeout
        if self.goal is None or not 0.0 < timeout <= min(now - self._silent_since, silence):
            return
        reason = f"no pose for pose_lost_timeout = {timeout:g} s"
        if self.goals.present is not None:
            self.give_up(reason, end=goal_record.POSE_LOST)
        elif self._is_held:
            self._let_go(f"the goal is held no longer: {reason}")

    def _whole_timeout(self) -> float:
        """Return the time [s] within which all goals of the path have to be reached."""
        return self.timeout * (max(self.waypoints, 1) if self.config.goal_timeout > 0.0 else 1)

    def give_up(self, reason: str, has_failed: bool = False, end: str = goal_record.NOT_REACHED) -> None:
        """End the present goal with a reason, and come to rest; ``has_failed`` if the law or the node is at fault."""
        self.reason, self.has_failed = reason, has_failed
        self.goals.close(end, reason)
        self._go_idle(NOT_REACHED)

    def _go_idle(self, state: str) -> None:
        self.goal = None
        self._route = []
        self.report = None
        self.state = state
        self._zeros_due = _STOP_REPEATS

    def _come_to_rest(self, dt: float) -> Twist | None:
        self.memory, command = self._driver.slow_down(self.memory, self._command, dt, self.config.controller)
        self._command = command
        if command != (0.0, 0.0):
            return command
        self.goals.close_cancelled()
        if self._zeros_due > 0:
            self._zeros_due -= 1
            return command
        return command if self.config.publish_when_idle else None
