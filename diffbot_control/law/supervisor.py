"""The controller's states: goals and paths, missing poses, coming to rest. Free of ROS; times in seconds."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from diffbot_control.law import goal_record
from diffbot_control.law.configuration import Report
from diffbot_control.law.controller import SwitchingLaw
from diffbot_control.law.driver import STOP, LawError, driver_of, scaled_uncertainty
from diffbot_control.law.goal_record import ANONYMOUS, GoalBook, GoalRequest, distance_along
from diffbot_control.law.limits import is_beyond
from diffbot_control.law.protocol import Law
from diffbot_control.law.supervisor_config import SupervisorConfig as SupervisorConfig  # noqa: PLC0414 - re-exported
from diffbot_core.data_sheet import DataSheet
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
_STOP_REPEATS = 5
"""Zero commands sent after a stop, so that one lost message does not leave the robot driving."""


class _StepInput(NamedTuple):
    """What the newest step started from, so that it can be repeated with a corrected pose."""

    memory: Any
    """of the law"""
    dt: float
    """[s]"""


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
        self._goal_stamp: int | None = None
        """[ns] of the first pose with the present goal"""
        self._stamps = StampWatch()
        self.pose: Pose | None = None
        self._answer: Twist | None = None
        """to the newest pose"""
        self._command = STOP
        """the last one"""
        self._step_input: _StepInput | None = None
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

    def on_path(self, goals: list[Pose], request: GoalRequest = ANONYMOUS) -> None:
        """Drive to ``goals`` one after the other (at least one); the last one is held."""
        self._accept(request)
        self.waypoint, self.waypoints = 1, len(goals)
        self._route = goals[1:]
        self._answer = None
        self._drive_to(goals[0])

    def _accept(self, request: GoalRequest) -> None:
        self.goals.accept(request)
        self._silent_since = request.time

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

    def on_pose(self, stamp: int, now: float, pose: Pose, uncertainty: Uncertainty = CERTAIN) -> Twist | None:
        """Answer a pose. Only one whose stamp advances is a sign of life; a repeated one may correct the last step.

        Args:
            stamp: [ns] time the pose belongs to.
            now: [s] time of arrival, on the clock of :meth:`on_tick`.
            pose: in the frame of the goals.
            uncertainty: of the pose; by default the pose is assumed exact.
        """
        before, advances, dt = self._stamps.newest, self._stamps.advances(stamp), 0.0
        if advances:
            dt = 0.0 if before is None else min((stamp - before) * S_PER_NS, _MAX_STEP)
            self._last_pose_time = self._silent_since = now
        self.goals.now = now
        same_step, same_pose = stamp == before, pose == self.pose
        if self.goal is None:
            self.pose = pose
            return self._come_to_rest(dt)
        if not advances and (self.state == STALE or self._is_overdue(now)):
            # The sender repeats itself, and the robot may be anywhere by now.
            return STOP
        if stamp < self._stamps.newest and self._answer is not None:
            # Out of order: a newer pose is answered already.
            return self._answer
        self.pose = pose
        if same_step and self._answer is not None:
            # A pose that is sent again, as in lock-step after a stall, is not a new step: the answer is the same.
            if same_pose:
                return self._answer
            # A pose corrected by a fix that came after the odometry: repeat the step with it.
            if self._step_input is not None:
                self.memory, dt = self._step_input
        self.uncertainty = uncertainty
        self._answer = self._take_step(self.goal, pose, dt)
        return self._answer

    def _take_step(self, goal: Pose, pose: Pose, dt: float) -> Twist:
        self._step_input = _StepInput(self.memory, dt)
        estimate = Estimate(pose, self.uncertainty)
        try:
            self.memory, command, self.report = self._driver.step(
                self.memory, estimate, goal, dt, self.config.controller
            )
        except LawError as error:
            self.give_up(str(error), has_failed=True)
            return self._come_to_rest(dt) or STOP
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
            reason = self._reason_to_give_up()
            if reason:
                self.give_up(reason)
        return command

    def _reason_to_give_up(self) -> str:
        """Return why the present goal is given up, empty if it is not."""
        stamp = self._stamps.newest
        if stamp is None:
            return ""
        if self._goal_stamp is None:
            self._goal_stamp = stamp
        timeout = self.config.goal_timeout
        if 0.0 < timeout <= (stamp - self._goal_stamp) * S_PER_NS:
            return f"not reached within goal_timeout = {timeout:g} s"
        return self._driver.reason_to_give_up(self.memory, self.config)

    def _state_of_drive(self, command: Twist) -> str:
        if self.memory.reached:
            return REACHED
        config = self.config.controller
        uncertain = self._driver.is_too_uncertain(self.memory, command, self.uncertainty, config)
        return UNCERTAIN if uncertain else DRIVING

    def smallest_tolerance(self) -> tuple[float, float]:
        """Position [m] and heading [rad] tolerance that the present uncertainty allows this project's law at best."""
        sigmas = self.config.controller.tolerance.goal_sigmas
        xy, theta = scaled_uncertainty(self.uncertainty, self.config.controller)
        return sigmas * xy, sigmas * theta

    def on_tick(self, now: float, silence: float = math.inf, is_stale: bool = False) -> Twist | None:
        """Watch for missing poses: zero if the robot may be moving and ``is_stale``, or no pose for ``pose_timeout``.

        A goal is given up only if ``silence`` [s], by a clock that neither jumps nor runs fast, is too long as well.
        """
        self.goals.now = now
        self._watch_for_loss(now, silence)
        if self._last_pose_time is None or (self.goal is None and self._zeros_due == 0):
            return None
        # Time that runs backwards (a restarted simulation) must not disable the timeout.
        self._last_pose_time = min(self._last_pose_time, now)
        if not is_stale and not self._is_overdue(now):
            return None
        self.memory = self._driver.halted(self.memory)
        self._command = STOP
        self.goals.close_cancelled()
        if self.goal is None:
            self._zeros_due -= 1
        else:
            self.state = STALE
        return STOP

    def _is_overdue(self, now: float) -> bool:
        return self._last_pose_time is not None and now - self._last_pose_time > self.config.pose_timeout

    def _watch_for_loss(self, now: float, silence: float) -> None:
        """Give the goal up if no pose has come for ``pose_lost_timeout``; a goal that was reached is kept."""
        self._silent_since = min(self._silent_since, now)
        timeout = self.config.pose_lost_timeout
        is_lost = 0.0 < timeout <= min(now - self._silent_since, silence)
        if self.goal is not None and self.goals.present is not None and is_lost:
            self.give_up(f"no pose for pose_lost_timeout = {timeout:g} s", end=goal_record.POSE_LOST)

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
