"""The controller without ROS: it computes commands from goals, poses and elapsed time, and ends each goal once.

:mod:`diffbot_control.goals.states` defines the transitions; this module detects the events. Times in seconds.
"""

from __future__ import annotations

import math
from contextlib import suppress
from typing import Annotated, Any, NamedTuple

from diffbot_control.goals import states, timing
from diffbot_control.goals.record import ANONYMOUS, REACHED, SUSPENSION, GoalBook, GoalRequest
from diffbot_control.goals.states import TABLE, WITH_GOAL, GoalEvent, Reaction, State
from diffbot_control.goals.timing import MAX_STEP, GoalGuard, PoseClock, RemainingPath
from diffbot_control.law import CONTACT_UNKNOWN, OMEGA_L, Law, Observation, Report, SwitchingConfig, SwitchingLaw
from diffbot_control.law.goal_checker import is_at_rest, is_knowable, smallest_tolerance
from diffbot_control.law.law import LawError, braking_step, errors_of, guarded_step
from diffbot_control.law.limits import is_beyond
from diffbot_core.errors import BadMessageError
from diffbot_core.geometry import Pose, wrap_angle
from diffbot_core.kinematics import STOP, Twist
from diffbot_core.schema import DISTANCE, TIME, TIMEOUT, Spec, known_fields
from diffbot_core.uncertainty import CERTAIN, Estimate, Uncertainty

_NEAR_TOLERANCES = 3.0
"""Distance from the last goal, as a multiple of the tolerance, within which manoeuvres need not reduce the distance."""
_STOP_REPEATS = 5
"""Number of zero commands after a stop, so that the robot stops even if one message is lost."""
_MAX_UPDATE_ANGLE = 0.5
"""[rad] largest difference between the headings of a goal_update and of the current goal"""


@known_fields
class SupervisorConfig(NamedTuple):
    """Parameters of the law and of the supervisor."""

    controller: SwitchingConfig = SwitchingConfig()
    """parameters of the law"""
    uncertainty_scale: Annotated[
        float,
        Spec("factor on the standard deviations of the pose, above 1 for an overconfident filter", "-", 0.0, 100.0),
    ] = 1.0
    pose_timeout: Annotated[float, Spec("time without a pose after which the robot is stopped", "s", *TIMEOUT)] = 0.5
    pose_lost_timeout: Annotated[
        float, Spec("time without a pose after which the goal is given up; 0: never", "s", *TIME)
    ] = 30.0
    waypoint_radius: Annotated[
        float,
        Spec(
            "distance at which a waypoint of a path counts as passed; 0: reach each waypoint within the tolerances",
            "m",
            *DISTANCE,
        ),
    ] = 0.4
    hold_goal: Annotated[bool, Spec("hold a reached goal against disturbances; otherwise go idle")] = True
    hold_distance: Annotated[
        float,
        Spec(
            "distance from a held goal beyond which the robot goes idle instead of returning; at least twice "
            "xy_goal_tolerance",
            "m",
            *DISTANCE,
        ),
    ] = 0.5
    goal_timeout: Annotated[
        float,
        Spec("time after which a goal is given up; -1: derived from distance and limits; 0: never", "s", -1.0, TIME[1]),
    ] = -1.0
    goal_update_distance: Annotated[
        float,
        Spec("largest distance of a goal_update from the current goal; goals farther away are dropped", "m", *DISTANCE),
    ] = 0.5
    publish_when_idle: Annotated[
        bool, Spec("answer every pose, with a zero command if there is no goal (lock-step needs it)")
    ] = False


class Supervisor:
    """Computes commands from goals, poses and elapsed time.

    Each method ``on_...`` handles an event from outside. The caller sends the command that it returns, if any.
    """

    def __init__(self, config: SupervisorConfig, law: type[Law] = SwitchingLaw) -> None:
        """Start idle; ``config.controller`` is an instance of ``law.Config``.

        Raises:
            LawError: if the law raises an error.
        """
        self.config, self.law = config, law
        self.state = State.IDLE
        self.goals = GoalBook()
        self.clock = PoseClock()
        self.goals_ahead: list[Pose] = []
        """the current goal, and the later goals of its path"""
        self.waypoint = self.waypoints = 0
        """number of the current goal in its path, from 1, and length of the path; both 0 for a single goal"""
        self.updates = 0
        """number of corrections of the current goal"""
        self.contact = CONTACT_UNKNOWN
        """contact with the dock: CONTACT_UNKNOWN, NO_CONTACT or CONTACT"""
        self.problem = ""
        """what keeps the robot from driving, set by the caller; it is added to the reason of a goal that is given up"""
        self.pose_fault = ""
        """fault of the inputs of the filter, set by the caller; it is the reason of a goal that is reached meanwhile"""
        self.report: Report | None = None
        self.reason = ""
        """why the last goal was not reached; empty if it was reached, or has not ended"""
        self.has_failed = False
        """True if the last goal ended because of an error of the law or of the node"""
        self.goals_reached = 0
        """number of goals reached; a held goal counts once"""
        self.accepted = 0
        """number of goals and paths accepted"""
        self.pose: Pose | None = None
        self.uncertainty = CERTAIN
        """uncertainty of the newest pose, times uncertainty_scale"""
        self.is_stale = False
        """True if the robot was stopped because no pose arrived within pose_timeout"""
        self._waits = self._is_uncertain = False
        """True until the first pose after a new goal; True if the robot rests and its estimate is too uncertain"""
        self._text = states.IDLE
        """status while there is no goal"""
        self._failure = ""
        """error of the law outside of a step; it ends the goal at the next event"""
        self._guard = GoalGuard()
        self._command = STOP
        self._since_command = self._since_step = 0.0
        """[s] time since the last command, and since the last step of the law"""
        self._zeros_due = 0
        """number of zero commands that still have to be sent"""
        with errors_of(law):
            self.memory: Any = law.new_memory(config.controller)
            self.data_sheet, self.tolerance = law.data_sheet(config.controller), law.tolerance(config.controller)

    @property
    def status(self) -> str:
        """The text of ~/status, one of ``states.STATUS_TEXTS``."""
        if self.state not in WITH_GOAL:
            return states.CANCELLING if self.goals.present is not None else self._text
        if self.is_stale:
            return states.STALE
        if self.state is State.HOLDING:
            return states.DRIVING if not self.memory.reached or self._is_returning() else states.AT_GOAL
        if self._waits:
            return states.WAITING
        return states.UNCERTAIN if self._is_uncertain else states.DRIVING

    @property
    def goal(self) -> Pose | None:
        """The goal to which the robot drives, or which it holds."""
        return self.goals_ahead[0] if self.goals_ahead else None

    @property
    def timeout(self) -> float:
        """Time [s] allowed for the current goal; a derived time is for the whole path."""
        return self._guard.timeout

    @property
    def elapsed(self) -> float:
        """Time [s] since the newest goal was accepted."""
        return self._guard.age

    def distance_remaining(self) -> float:
        """Return the length [m] of the straight lines through all remaining goals; 0 without a goal."""
        return 0.0 if self.pose is None else timing.distance_along(self.pose, self.goals_ahead)

    @property
    def is_beyond_limits(self) -> bool:
        """True if the last command exceeds a bound that was lowered while driving, so that the robot still brakes."""
        return is_beyond(self._command, self.data_sheet)

    def description(self) -> dict[str, str]:
        """Return the law's description of its memory; if the law raises an error, the goal ends at the next event."""
        try:
            with errors_of(self.law):
                pairs = self.law.describe(self.memory, self.config.controller).items()
                return {str(name): str(value) for name, value in pairs}
        except LawError as error:
            self._failure = str(error)
            return {}

    def _is_returning(self) -> bool:
        """Return True if the robot has left a held goal and drives back."""
        is_outside = self.report is not None and self.report.rho > self.tolerance.xy_goal_tolerance
        return is_outside and not is_at_rest(self._command, self.data_sheet)

    def on_goal(self, goal: Pose, request: GoalRequest = ANONYMOUS) -> None:
        """Drive to ``goal`` (in the frame of the poses) from the next pose on; replace an earlier goal or path."""
        self._accept([goal], request, 0, 0)

    def on_path(self, goals: list[Pose], request: GoalRequest = ANONYMOUS) -> None:
        """Drive to each of the goals in turn, and hold the last one; there is at least one."""
        self._accept(goals, request, 1, len(goals))

    def on_goal_update(self, goal: Pose) -> None:
        """Correct the only goal, or the last goal of the path; the law keeps its memory.

        A goal that has ended is not corrected.

        Raises:
            BadMessageError: if ``goal`` (in the frame of the poses) is too far from the current goal.
        """
        if self.goals.present is None or not self.goals_ahead:
            return
        last, bound = self.goals_ahead[-1], self.config.goal_update_distance
        distance = math.hypot(goal.x - last.x, goal.y - last.y)
        if distance > bound:
            raise BadMessageError("far from the goal", f"{distance:.3g} m, goal_update_distance = {bound:g} m")
        turn = abs(wrap_angle(goal.theta - last.theta))
        if turn > _MAX_UPDATE_ANGLE:
            raise BadMessageError("heading differs from the goal", f"{turn:.3g} rad, at most {_MAX_UPDATE_ANGLE:g} rad")
        self.goals_ahead[-1] = goal
        self.updates += 1

    def on_cancel(self, reason: str = "") -> Twist | None:
        """Cancel the goal, if there is one, and start to brake before the next pose; ``reason`` says who cancels it."""
        if self.state not in WITH_GOAL:
            return None
        self.waypoint = self.waypoints = 0
        self.goals.cancel(reason)
        command = self._follow(GoalEvent.CANCEL)
        # In lock-step each pose has exactly one answer.
        return None if self.config.publish_when_idle else command

    def on_pose(
        self, stamp: int, now: float, pose: Pose, uncertainty: Uncertainty = CERTAIN, steady: float = math.nan
    ) -> Twist | None:
        """Return the command for a pose. A pose counts only if its stamp is later than the stamps of all earlier poses.

        Args:
            stamp: [ns] time to which the pose belongs.
            now: [s] time of arrival, on the clock of :meth:`on_tick`.
            pose: pose in the frame of the goals.
            uncertainty: uncertainty of the pose; by default the pose is assumed exact.
            steady: [s] time of arrival on the steady clock; nan without one.
        """
        self.pass_time(now, steady)
        dt = self.clock.on_pose(stamp)
        if not self.clock.advances or self._is_overdue():
            command = self._stop_if_overdue()
        else:
            scale = self.config.uncertainty_scale
            self.pose, self.uncertainty = pose, Uncertainty(scale * uncertainty.xy, scale * uncertainty.theta)
            self._waits = self.is_stale = False
            release = self._reason_to_release(pose)
            command = self._follow(GoalEvent.ELSEWHERE if release else GoalEvent.POSE, release, dt)
        is_due = self.clock.advances and self.config.publish_when_idle
        return STOP if command is None and is_due else command

    def on_tick(self, now: float, steady: float = math.nan, must_stop: bool = False) -> Twist | None:
        """Count the time; return zero if the robot may be moving and no pose has arrived within ``pose_timeout``.

        Args:
            now: [s] time on the clock of :meth:`on_pose`.
            steady: [s] time on the steady clock; nan without one.
            must_stop: True if the robot must not move, because the clock of the poses is unreliable.
        """
        self.pass_time(now, steady)
        lost = self.config.pose_lost_timeout
        is_lost, reason = 0.0 < lost <= self.clock.silence, f"no pose for pose_lost_timeout = {lost:g} s"
        command = self._follow(GoalEvent.LOST, reason) if is_lost else None
        return command or self._stop_if_overdue(must_stop)

    def on_stop(self, reason: str) -> None:
        """End the current goal as cancelled, because the node stops; the node itself sends zero."""
        self._follow(GoalEvent.STOP, reason)
        self.reason, self.problem, self.has_failed = "", "", False

    def give_up(self, reason: str) -> None:
        """End the current goal as not reached."""
        self._follow(GoalEvent.HOPELESS, reason)

    def on_fault(self, reason: str, dt: float = 0.0) -> Twist | None:
        """End the current goal because of an error, and brake from the last command, which was ``dt`` [s] ago."""
        self.has_failed = True
        return self._follow(GoalEvent.FAULT, reason, dt)

    def pass_time(self, now: float, steady: float) -> None:
        """Count the time since the last event, as an event itself; a new goal is one. Arguments as for on_tick()."""
        passed = self.clock.pass_time(now, steady)
        self._since_command += passed
        self._since_step = min(self._since_step + passed, MAX_STEP)
        if self.goals.present is not None:
            self._guard.pass_time(passed)
            if self.clock.suspension > SUSPENSION:
                self.give_up(f"the controller was suspended for {self.clock.suspension:.1f} s")
            elif reason := self._guard.timeout_reason():
                self.give_up(reason)
        if self._failure and self.state in WITH_GOAL:
            self.on_fault(self._failure)
        self._failure = ""

    def _is_overdue(self) -> bool:
        # In lock-step the plant waits for the command, however long this takes in real time.
        is_lockstep = self.clock.is_simulated and self.config.publish_when_idle
        return self.clock.is_overdue(self.config.pose_timeout, not is_lockstep)

    def _stop_if_overdue(self, must_stop: bool = False) -> Twist | None:
        is_needed = self.clock.has_pose and (self._zeros_due > 0 or self.state is not State.IDLE)
        return self._follow(GoalEvent.OVERDUE) if is_needed and (must_stop or self._is_overdue()) else None

    def _reason_to_release(self, pose: Pose) -> str:
        """Return why the robot stops holding its goal; empty if it continues, or does not hold a goal."""
        if self.state is not State.HOLDING or self.goal is None:
            return ""
        bound = max(self.config.hold_distance, 2.0 * self.tolerance.xy_goal_tolerance)
        distance = math.hypot(pose.x - self.goal.x, pose.y - self.goal.y)
        text = f"the robot was found {distance:.2f} m from the held goal: hold_distance = {bound:g} m"
        return text if distance > bound else ""

    def _follow(self, event: GoalEvent, reason: str = "", dt: float = 0.0) -> Twist | None:
        """Make the transition that the table defines for an event, and return its command."""
        transition = TABLE[self.state].get(event)
        if transition is None:
            return None
        had_goal, self.state = self.state in WITH_GOAL, transition.state
        if event in (GoalEvent.LOST, GoalEvent.HOPELESS):
            reason = "; ".join(filter(None, (reason, self.problem)))
        self.is_stale = self.is_stale or event is GoalEvent.OVERDUE
        if transition.end:
            doubt = self.pose_fault if transition.end == REACHED else ""
            self.goals.close(transition.end, reason or doubt, self._guard.age)
        self._text = transition.text or self._text
        if self.state not in WITH_GOAL:
            self.reason = reason or self.reason
            if had_goal:
                self.goals_ahead, self.report, self._zeros_due = [], None, _STOP_REPEATS
        return self._command_for(transition.command, dt)

    def _command_for(self, command: Reaction, dt: float) -> Twist | None:
        if command is Reaction.LAW:
            if self.state is State.DRIVING and self.pose is not None:
                self._skip_goals(timing.goals_passed(self.pose, self.goals_ahead, self.config.waypoint_radius))
            # There is no goal if the law has just raised an error for the next goal of the path.
            return self._brake(dt) if self.goal is None else self._take_step(self.goal, dt)
        if command is Reaction.BRAKE:
            return self._brake(dt)
        if command is Reaction.REST:
            return self._rest()
        return self.stop_at_once() if command is Reaction.ZERO else None

    def _accept(self, goals: list[Pose], request: GoalRequest, waypoint: int, waypoints: int) -> None:
        is_replanned = self.goals.present is not None and self.goals_ahead[-1:] == goals[-1:]
        rest = self._since_command if self.accepted and self.state is State.IDLE else 0.0
        self._follow(GoalEvent.GOAL, f"by a newer goal ({request.source})" if request.source else "")
        self.goals.accept(request)
        self.accepted += 1
        if not is_replanned:
            self.clock.on_goal()
        self.goals_ahead = list(goals)
        self.waypoint, self.waypoints, self.updates = waypoint, waypoints, 0
        self._waits, self.is_stale, self.reason, self.has_failed, self._since_step = True, False, "", False, 0.0
        with suppress(LawError), errors_of(self.law):  # the next step reports the error
            self.data_sheet = self.law.data_sheet(self.config.controller)
        length, radius = timing.distance_along(self.pose or goals[0], goals), self.config.waypoint_radius
        ahead = timing.distance_ahead(self.pose or goals[0], goals, radius) if is_replanned else math.nan
        self._guard.accept(self.config.goal_timeout, length, len(goals), self.data_sheet, self.pose is not None, ahead)
        self._begin_goal(rest)

    def _begin_goal(self, rest: float = 0.0) -> None:
        """Prepare the law for the first of the goals ahead; ``rest`` [s] is the time at rest since the last goal."""
        self.report, self._is_uncertain = None, False
        try:
            with errors_of(self.law):
                if rest > 0.0:
                    self.memory = self.law.after_command(self.memory, STOP, rest, self.config.controller)
                self.memory = self.law.memory_for_new_goal(self.memory, self.config.controller)
        except LawError as error:
            self.on_fault(str(error))

    def _skip_goals(self, number: int) -> None:
        """Drop the first ``number`` goals ahead, and begin the goal after them."""
        if number:
            self.waypoint += number
            self.goals_ahead = self.goals_ahead[number:]
            self._guard.next_goal()
            self._begin_goal()

    def _take_step(self, goal: Pose, dt: float) -> Twist | None:
        law, config = self.law, self.config.controller
        observation = Observation(Estimate(self.pose or goal, self.uncertainty), dt, self.clock.period, self.contact)
        try:
            step = guarded_step(law, self.memory, observation, goal, self._command, config)
        except LawError as error:
            return self.on_fault(str(error), dt)
        self.memory, self.report = step.memory, step.report
        self.data_sheet, self.tolerance = step.data_sheet, step.tolerance
        self._command, self._since_command = step.command, 0.0
        if self.state is State.DRIVING:
            self._check_step(step.report, step.reason_to_give_up)
        self._since_step = 0.0
        return step.command

    def _check_step(self, report: Report, reason_of_law: str) -> None:
        """Detect that the goal is reached, or has to be given up."""
        reached, is_last = bool(self.memory.reached), len(self.goals_ahead) == 1
        self.goals_reached += reached
        if reached and is_last:
            self._follow(GoalEvent.REACHED if self.config.hold_goal else GoalEvent.RELEASE)
        elif reached:
            self._skip_goals(1)
        elif reason := self._reason_to_give_up(report) or reason_of_law:
            self._follow(GoalEvent.HOPELESS, reason)

    def _reason_to_give_up(self, report: Report) -> str:
        distance, goals, tolerance = self.distance_remaining(), len(self.goals_ahead), self.tolerance
        is_near = goals == 1 and distance <= _NEAR_TOLERANCES * tolerance.xy_goal_tolerance
        is_at_rest_there = (is_near or report.region == OMEGA_L) and is_at_rest(self._command, self.data_sheet)
        self._is_uncertain = is_at_rest_there and not is_knowable(tolerance, self.uncertainty)
        path = RemainingPath(distance, goals, is_near, is_at_rest_there)
        reason = self._guard.reason_to_give_up(self._since_step, path, self.config.goal_timeout, self.data_sheet)
        if reason and self._is_uncertain:
            xy, theta = smallest_tolerance(self.tolerance, self.uncertainty)
            return f"the estimate is too uncertain: the smallest possible tolerances are {xy:.3g} m and {theta:.3g} rad"
        return reason

    def _brake(self, dt: float) -> Twist | None:
        """Continue to brake within the limits; stop at once if the law raises an error."""
        try:
            self.memory, command = braking_step(self.law, self.memory, self._command, dt, self.config.controller)
        except LawError as error:
            self.has_failed, self.reason, command = True, self.reason or str(error), STOP
        self._command, self._since_command = command, 0.0
        if command != STOP:
            return command
        self._follow(GoalEvent.AT_REST)
        return self._rest()

    def _rest(self) -> Twist | None:
        """Repeat the zero command until it was sent _STOP_REPEATS times."""
        is_due = self._zeros_due > 0
        self._zeros_due -= is_due
        return STOP if is_due else None

    def stop_at_once(self) -> Twist:
        """Return a zero command, also instead of one that was not sent; the next command starts from rest."""
        try:
            with errors_of(self.law):
                self.memory = self.law.after_command(self.memory, STOP, self._since_command, self.config.controller)
        except LawError as error:
            self.has_failed, self.reason = True, str(error)
            if self.state in WITH_GOAL:
                self._follow(GoalEvent.FAULT, str(error))
        self._command, self._since_command = STOP, 0.0
        self.clock.halt()
        if self.state not in WITH_GOAL:
            self._zeros_due = max(self._zeros_due - 1, 0)
        return STOP
