"""The controller without ROS: goals, poses and the passing of time -> commands and answers. Times in seconds.

What an event leads to stands in :mod:`diffbot_control.goals.states`; here is found out which events happen.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from diffbot_control.goals.configuration import SupervisorConfig
from diffbot_control.goals.driver import STOP, LawError, driver_of, scaled_uncertainty
from diffbot_control.goals.goal_record import ANONYMOUS, GoalBook, GoalRequest, distance_along
from diffbot_control.goals.progress import Patience, Progress, Way
from diffbot_control.goals.protocol import Law, data_sheet_of, tolerance_of
from diffbot_control.goals.states import ACTIVE, TABLE, WITH_GOAL, Command, Event, State, status_text
from diffbot_control.goals.step_clock import StepClock
from diffbot_control.law.configuration import Report
from diffbot_control.law.controller import SwitchingLaw
from diffbot_control.law.goal_checker import GoalTolerance, is_at_rest, smallest_tolerance
from diffbot_control.law.limits import is_beyond
from diffbot_core.data_sheet import UNLIMITED, DataSheet
from diffbot_core.errors import BadMessageError
from diffbot_core.geometry import Pose, wrap_angle
from diffbot_core.kinematics import Twist
from diffbot_core.stamps import StampWatch
from diffbot_core.uncertainty import CERTAIN, Estimate, Uncertainty
from diffbot_core.units import S_PER_NS

_MAX_STEP = 1.0
"""[s] a longer gap between poses counts as this long for the acceleration limits."""
_NEAR_TOLERANCES = 3.0
"""Tolerances from the last goal within which the robot need not come closer."""
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
        self.state = State.IDLE
        self.goals = GoalBook()
        """which goals were accepted, and how each ended"""
        self.goals_ahead: list[Pose] = []
        """the present goal, and those of its path that follow"""
        self.waypoint = 0
        """number of the present goal in its path, from 1; 0 for a single goal"""
        self.waypoints = 0
        """goals of the path"""
        self.updates = 0
        """corrections of the present goal so far"""
        self.report: Report | None = None
        self.reason = ""
        """why the last goal was not reached; empty if it was, or is still driven to"""
        self.has_failed = False
        """the last goal was given up because of an error: the law's or the node's own"""
        self.goals_reached = 0
        """goals reached so far; each is counted once, even if lost and reached again"""
        self.accepted = 0
        """goals and paths accepted so far"""
        self.pose: Pose | None = None
        self.uncertainty = CERTAIN
        """of the newest pose"""
        self._is_uncertain = False
        """the robot rests, with an estimate too uncertain for an answer"""
        self._patience = Patience()
        self._stamps = StampWatch()
        self._answer: Twist | None = None
        """to the newest pose"""
        self._command = STOP
        """the last one"""
        self._acted_at = 0.0
        """[s] of the newest step or stop"""
        self._sent_at = math.nan
        """[s] steady time of the newest step"""
        self._step_input: _StepInput | None = None
        self._step_clock = StepClock()
        self._last_pose_time: float | None = None
        """[s] of the newest pose whose stamp advanced"""
        self._silent_since = 0.0
        """[s] of that pose, or of a goal after it"""
        self._zeros_due = 0

    # What is known

    @property
    def status(self) -> str:
        """The message of ~/status, one of ``states.STATUS_TEXTS``."""
        return status_text(self.state, self._is_uncertain, not self.memory.reached or self._corrects())

    @property
    def goal(self) -> Pose | None:
        """The goal that is driven to, or held."""
        return self.goals_ahead[0] if self.goals_ahead else None

    @property
    def timeout(self) -> float:
        """Time [s] within which the present goal, if derived the whole path, has to be reached."""
        return self._patience.timeout

    def distance_remaining(self) -> float:
        """Return the length [m] of the straight lines to the goal, or through what is left of the path; 0 if idle."""
        return 0.0 if self.pose is None else distance_along(self.pose, self.goals_ahead)

    @property
    def is_beyond_limits(self) -> bool:
        """True if the last command exceeds a bound: it was lowered while driving, and the robot still brakes."""
        sheet = getattr(self.config.controller, "data_sheet", None)
        return isinstance(sheet, DataSheet) and is_beyond(self._command, sheet)

    def smallest_tolerance(self) -> tuple[float, float]:
        """Position [m] and heading [rad] tolerance that the present uncertainty allows this project's law at best."""
        controller = self.config.controller
        return smallest_tolerance(controller.tolerance, scaled_uncertainty(self.uncertainty, controller))

    def _data_sheet(self) -> DataSheet:
        """Return the limits of the law's configuration; those of a law without any are the defaults."""
        return data_sheet_of(self.config.controller) or DataSheet()

    def _tolerance(self) -> GoalTolerance:
        return tolerance_of(self.config.controller)

    def _corrects(self) -> bool:
        """True if the robot has left a reached goal and drives back."""
        tolerance = self._tolerance()
        sheet = getattr(self.config.controller, "data_sheet", UNLIMITED)
        is_outside = self.report is not None and self.report.rho > tolerance.xy_goal_tolerance
        return is_outside and not is_at_rest(self._command, tolerance, sheet)

    # What happens

    def on_goal(self, goal: Pose, request: GoalRequest = ANONYMOUS) -> None:
        """Drive to ``goal`` (frame of the poses) from the next pose on; the newest goal or path wins."""
        self._accept([goal], request, 0, 0)

    def on_path(self, goals: list[Pose], request: GoalRequest = ANONYMOUS) -> None:
        """Drive to ``goals``, at least one, one after the other; the last one is held."""
        self._accept(goals, request, 1, len(goals))

    def on_goal_update(self, goal: Pose) -> None:
        """Correct the goal, of a path the last one, without a new beginning: region, course and finish go on.

        A goal that is held after its answer stays where it is.

        Raises:
            BadMessageError: if ``goal`` (frame of the poses) is farther from the present one than the bounds.
        """
        if self.goals.present is None or not self.goals_ahead:
            return
        last, bounds = self.goals_ahead[-1], self.config.updates
        distance = math.hypot(goal.x - last.x, goal.y - last.y)
        if distance > bounds.goal_update_distance:
            bound = f"goal_update_distance = {bounds.goal_update_distance:g} m"
            raise BadMessageError("far from the goal", f"{distance:.3g} m, {bound}")
        turn = abs(wrap_angle(goal.theta - last.theta))
        if turn > bounds.goal_update_angle:
            bound = f"goal_update_angle = {bounds.goal_update_angle:g} rad"
            raise BadMessageError("turned against the goal", f"{turn:.3g} rad, {bound}")
        self.goals_ahead[-1] = goal
        self.updates += 1

    def on_contact(self, touches: bool) -> None:
        """Tell a law that docks whether the robot touches its dock."""
        if hasattr(self.memory, "contact"):
            self.memory = self.memory._replace(contact=touches)

    def on_cancel(self) -> Twist | None:
        """Drop the goal, if there is one, and start to come to rest at once, with or without a pose."""
        if self.state not in WITH_GOAL:
            return None
        self.waypoint = self.waypoints = 0
        self.goals.cancel()
        command = self._follow(Event.CANCEL)
        # Lock-step wants one answer to each pose, and none besides.
        return None if self.config.publish_when_idle else command

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
            self._last_pose_time = self._silent_since = now
        # A pose that is no step takes its time, too: it is answered by a command.
        dt = self._step_clock.limited(dt, steady)
        self.goals.now = now
        if self.state not in WITH_GOAL:
            self.pose = pose
            return self._follow(Event.POSE, dt=dt)
        reason = self._reason_to_let_go(pose)
        if reason:
            self.pose = pose
            return self._follow(Event.ELSEWHERE, reason, dt)
        if not advances and (self.state in (State.STALE, State.HOLDING_STALE) or self._is_overdue(now)):
            # The sender repeats itself, and the robot may be anywhere by now.
            return self._follow(Event.OVERDUE)
        if stamp != self._stamps.newest and self._answer is not None:
            # Out of order: a newer pose is answered already.
            return self._answer
        is_repeated = stamp == before and self._answer is not None
        if is_repeated and pose == self.pose:
            # Sent again, as in lock-step after a stall: it is not a new step, and the answer is the same.
            return self._answer
        self.pose, self.uncertainty = pose, uncertainty
        if is_repeated and self._step_input is not None:
            self._answer = self._repeat_step(self._step_input, steady - self._sent_at)
        else:
            self._answer = self._follow(Event.POSE, dt=dt)
        self._sent_at = steady
        return self._answer

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
        # Time that runs backwards (a restarted simulation) must not disable the timeouts.
        self._silent_since = min(self._silent_since, now)
        lost = self.config.pose_lost_timeout
        if 0.0 < lost <= min(now - self._silent_since, silence):
            self._follow(Event.LOST, f"no pose for pose_lost_timeout = {lost:g} s")
        if elapsed >= self._patience.whole_timeout(self.waypoints):
            self._follow(Event.HOPELESS, self._patience.timeout_reason())
        if self._last_pose_time is None or not (self._zeros_due or self.state in ACTIVE):
            return None
        self._last_pose_time = min(self._last_pose_time, now)
        return self._follow(Event.OVERDUE) if is_stale or self._is_overdue(now) else None

    def count_time_from(self, now: float) -> None:
        """Count goal and poses so far as of ``now`` [s]: they came before the clock was known, at time 0."""
        self.goals.count_time_from(now)
        self.goals.now = self._silent_since = self._acted_at = now
        if self._last_pose_time is not None:
            self._last_pose_time = now

    def on_stop(self) -> None:
        """End the present goal as cancelled: the node stops, which sends zero."""
        self._follow(Event.STOP)
        self.reason, self.has_failed = "", False

    def give_up(self, reason: str) -> None:
        """End the present goal as not reached."""
        self._follow(Event.HOPELESS, reason)

    def on_fault(self, reason: str, dt: float = 0.0) -> Twist | None:
        """End the present goal, if there is one, because of an error, ``dt`` [s] after the last command."""
        self.has_failed = True
        return self._follow(Event.FAULT, reason, dt)

    def _is_overdue(self, now: float) -> bool:
        return self._last_pose_time is not None and now - self._last_pose_time > self.config.pose_timeout

    def _reason_to_let_go(self, pose: Pose) -> str:
        """Return why a goal is held no longer; empty if it is not held, or the robot is near it."""
        if self.state not in (State.HOLDING, State.HOLDING_STALE) or self.goal is None:
            return ""
        bound = max(self.config.hold_distance, 2.0 * self._tolerance().xy_goal_tolerance)
        found = math.hypot(pose.x - self.goal.x, pose.y - self.goal.y)
        return f"found {found:.2f} m from the held goal: hold_distance = {bound:g} m" if found > bound else ""

    # What follows

    def _follow(self, event: Event, reason: str = "", dt: float = 0.0) -> Twist | None:
        """Go where the table says, answer the goal and return the command, if there is one."""
        transition = TABLE[self.state].get(event)
        if transition is None:
            return None
        had_goal, self.state = self.state in WITH_GOAL, transition.state
        if transition.answer:
            self.goals.close(transition.answer, reason)
        if self.state not in WITH_GOAL:
            self.reason = reason or self.reason
            if had_goal or event is Event.FAULT:
                self._drop_goal()
        return self._command_for(transition.command, dt)

    def _command_for(self, command: Command, dt: float) -> Twist | None:
        if command is Command.LAW and self.goal is not None:
            return self._take_step(self.goal, dt)
        if command is Command.BRAKE:
            return self._brake(dt)
        return self._stop_at_once() if command is Command.ZERO else None

    def _drop_goal(self) -> None:
        self.goals_ahead = []
        self.report = None
        self._zeros_due = _STOP_REPEATS

    def _accept(self, goals: list[Pose], request: GoalRequest, waypoint: int, waypoints: int) -> None:
        if request.time < math.inf:
            self.goals.now = request.time
        self._follow(Event.GOAL, f"by a newer goal ({request.source})" if request.source else "")
        self.goals.accept(request)
        self.accepted += 1
        self._silent_since = request.time
        self._answer = None
        self.goals_ahead = list(goals)
        self.waypoint, self.waypoints, self.updates = waypoint, waypoints, 0
        distance = distance_along(self.pose or goals[0], goals)
        option, is_known = self.config.goal_timeout, self.pose is not None
        self._patience.accept(option, distance, len(goals), self._data_sheet(), is_known)
        self.reason, self.has_failed = "", False
        self._begin_goal()

    def _begin_goal(self) -> None:
        """Begin with the first of the goals ahead."""
        self._step_input = self.report = None
        self._is_uncertain = False
        touches = getattr(self.memory, "contact", False)
        try:
            self.memory = self._driver.memory_for_new_goal(self.memory, self.config.controller)
            self.on_contact(touches)  # a switch may report changes only
        except LawError as error:
            self.on_fault(str(error))

    def _take_step(self, goal: Pose, dt: float) -> Twist | None:
        self._step_input = _StepInput(self.memory, dt, self._command, self._patience.progress)
        self._acted_at = self.goals.now
        estimate, config = Estimate(self.pose or goal, self.uncertainty), self.config.controller
        try:
            self.memory, command, self.report = self._driver.step(self.memory, estimate, goal, dt, config)
        except LawError as error:
            return self.on_fault(str(error), dt)
        self.memory, command = self._driver.limited(self.memory, command, self._command, dt, config)
        self._command = command
        self._is_uncertain = self._driver.is_too_uncertain(self.memory, command, self.uncertainty, config)
        if self.state is State.DRIVING:
            self._judge_step(self.report, dt)
        return command

    def _repeat_step(self, start: _StepInput, passed: float) -> Twist | None:
        """Take the newest step again, with a pose corrected by a fix that came after the odometry.

        Its command replaces one that was sent ``passed`` [s] ago, and keeps the limits since then, too; in simulated
        time (nan) none has passed for the base either.
        """
        sent = self._command
        self.memory, dt, self._command, self._patience.progress = start
        command = self._follow(Event.POSE, dt=dt)
        if command is None or math.isnan(passed):
            return command
        self.memory, self._command = self._driver.within_limits(
            self.memory, command, sent, max(passed, 0.0), self.config.controller
        )
        return self._command

    def _judge_step(self, report: Report, dt: float) -> None:
        """Find out whether the goal is reached, passed or hopeless."""
        reached, is_last = self.memory.reached, len(self.goals_ahead) == 1
        self.goals_reached += bool(reached)
        if reached and is_last:
            self._follow(Event.REACHED)
            if not self.config.hold_goal:
                self._follow(Event.RELEASE)
        elif not is_last and (reached or report.rho < self.config.waypoint_radius):
            self.waypoint += 1
            self.goals_ahead = self.goals_ahead[1:]
            self._patience.next_goal()
            self._begin_goal()
        else:
            reason = self._reason_to_give_up(dt)
            if reason:
                self._follow(Event.HOPELESS, reason)

    def _reason_to_give_up(self, dt: float) -> str:
        stamp, distance, goals = self._stamps.newest, self.distance_remaining(), len(self.goals_ahead)
        is_near = goals == 1 and distance <= _NEAR_TOLERANCES * self._tolerance().xy_goal_tolerance
        way = Way(distance, goals, is_near, self._is_uncertain, self.smallest_tolerance)
        reason = self._patience.reason_to_give_up(stamp or 0, dt, way, self.config.goal_timeout, self._data_sheet())
        return reason or self._driver.reason_to_give_up(self.memory, self.config)

    def _brake(self, dt: float) -> Twist | None:
        self.memory, self._command = self._driver.slow_down(self.memory, self._command, dt, self.config.controller)
        self._acted_at = self.goals.now
        if self._command != STOP:
            return self._command
        self._follow(Event.AT_REST)
        if self._zeros_due > 0:
            self._zeros_due -= 1
            return STOP
        return STOP if self.config.publish_when_idle else None

    def _stop_at_once(self) -> Twist:
        passed = min(max(self.goals.now - self._acted_at, 0.0), _MAX_STEP)
        self.memory = self._driver.halted(self.memory, passed, self.config.controller)
        self._command, self._acted_at = STOP, self.goals.now
        self._step_clock.halt()
        if self.state not in WITH_GOAL:
            self._zeros_due = max(self._zeros_due - 1, 0)
        return STOP
