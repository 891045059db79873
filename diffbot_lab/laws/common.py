"""Parts that the laws of this package share: base class, memory, situation, braking, limits, and the final turn."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Annotated, Any, NamedTuple

from diffbot_control.law.goal_checker import GoalTolerance, Settling, next_settling, within
from diffbot_control.law.latency import Actuation, after_a_period, coast, is_immediate, resting_actuation
from diffbot_control.law.law import Law, Observation, Report
from diffbot_control.law.limits import lifted_command, limit_change, limit_velocity
from diffbot_control.law.regions import OMEGA_G
from diffbot_control.law.steering import Navigation, braking, navigation_variables
from diffbot_core.data_sheet import DataSheet
from diffbot_core.geometry import Pose, into_frame, wrap_angle
from diffbot_core.kinematics import Twist
from diffbot_core.schema import Spec
from diffbot_core.uncertainty import Uncertainty

ROTATING, DRIVING, FINISHING, REACHED = 0, 1, 2, 3
"""Phases: turning towards the goal, driving to the goal, turning to the goal's heading, standing at the goal."""
_BRAKE_SHARE, _TURN_SHARE = 0.9, 0.7
"""Shares of the acceleration limits with which the robot brakes, so that the limits do not change these commands."""
_BRAKE_TIME = 0.1
"""[s] reaction time of braking before the goal"""
STOP = Twist(0.0, 0.0)


class Stop(NamedTuple):
    """Errors of the estimate at which a law stops. The goal checker decides when the goal is reached."""

    stop_distance: Annotated[float, Spec("distance to the goal at which the drive ends", "m", 0.0, 1.0)] = 0.035
    stop_angle: Annotated[float, Spec("heading error at which the final turn ends", "rad", 0.0, 1.0)] = 0.025


class Turning(NamedTuple):
    """Profile of turns on the spot: the largest rate from which the robot stops within the remaining angle."""

    turn_brake: Annotated[float, Spec("angular deceleration of turns", "rad/s^2", 0.1, 100.0)] = 8.0
    turn_time: Annotated[float, Spec("reaction time of turns, 1 / gain near the end", "s", 0.01, 5.0)] = 0.4


class PeerState(NamedTuple):
    """State of a law between steps."""

    phase: int
    direction: float
    """direction of travel: 1 forwards, -1 backwards, 0 not chosen yet"""
    value: float
    """a number whose meaning depends on the law"""


class LawMemory(NamedTuple):
    """Memory of a law of this package."""

    state: Any
    """a :class:`PeerState`, or another state that the law defines"""
    actuation: Actuation
    """commands that have not taken effect yet"""
    command: Twist
    """last command"""
    settling: Settling
    reached: bool


class Situation(NamedTuple):
    """Inputs of a law's decision, in the goal's frame."""

    pose: Pose
    """estimated pose; with dead time or lag, the coasted pose"""
    uncertainty: Uncertainty
    navigation: Navigation
    actuation: Actuation
    last: Twist
    """command of the last step"""
    settling: Settling
    """progress of the goal checker after the last step"""
    dt: float
    """[s] time since the last step"""


_NEW = PeerState(ROTATING, 0.0, 0.0)


def new_law_memory(state: Any = _NEW) -> LawMemory:
    """Return the memory of a robot at rest with a new goal."""
    return LawMemory(state, resting_actuation(), Twist(0.0, 0.0), Settling(0, False), False)


def situation_of(memory: LawMemory, observation: Observation, goal: Pose, sheet: DataSheet) -> Situation:
    """Return the situation at a step."""
    estimate, dt, actuation = observation.estimate, observation.dt, memory.actuation
    local = into_frame(estimate.pose, goal)
    pose = local
    if not is_immediate(sheet):
        coasted = coast(local, actuation, memory.command, dt, sheet)
        pose, actuation = coasted.pose, coasted.actuation
    navigation = navigation_variables(pose)
    return Situation(pose, estimate.uncertainty, navigation, actuation, memory.command, memory.settling, dt)


def conclude(
    state: Any,
    requested: Twist,
    situation: Situation,
    tolerance: GoalTolerance,
    sheet: DataSheet,
    region: int = OMEGA_G,
) -> tuple[LawMemory, Twist, Report]:
    """Limit a requested command to the data sheet, and check whether the goal is reached.

    Returns:
        The memory, the command and the report.
    """
    command = lifted_command(limit_velocity(requested, sheet), sheet)
    command = limit_change(command, situation.last, situation.dt, sheet)
    if not (math.isfinite(command.v) and math.isfinite(command.omega)):
        command = STOP
    pose, (rho, alpha, beta) = situation.pose, situation.navigation
    inside = within(pose, rho, command, tolerance, sheet, situation.uncertainty)
    settling = next_settling(situation.settling, inside, tolerance)
    report = Report(rho, alpha, beta, pose.theta, 0.0, region, math.nan)
    return LawMemory(state, situation.actuation, command, settling, settling.reached), command, report


def approach_speed(distance: float, sheet: DataSheet) -> float:
    """Return the speed [m/s] from which the robot can stop within ``distance`` [m]; inf if a_max = inf."""
    if sheet.a_max == math.inf:
        return math.inf
    return braking(distance, _BRAKE_SHARE * sheet.a_max, _BRAKE_TIME)


def turn_rate(angle: float, turning: Turning, sheet: DataSheet) -> float:
    """Return the rate [rad/s] of a turn whose remaining angle is ``angle`` [rad]."""
    brake = min(turning.turn_brake, _TURN_SHARE * sheet.omega_dot_max)
    return math.copysign(min(sheet.omega_max, braking(abs(angle), brake, turning.turn_time)), angle)


def final_turn(state: PeerState, theta: float, config: Any) -> tuple[PeerState, Twist]:
    """Turn to the goal's heading, then stop. ``config`` has the fields stop, turning and data_sheet."""
    if state.phase == REACHED or abs(theta) < config.stop.stop_angle:
        return PeerState(REACHED, state.direction, state.value), STOP
    omega = -turn_rate(theta, config.turning, config.data_sheet)
    return PeerState(FINISHING, state.direction, state.value), Twist(0.0, omega)


def bearing(navigation: Navigation, direction: float) -> float:
    """Return the bearing [rad] of the goal relative to the direction of travel, 1 or -1."""
    return navigation.alpha if direction > 0.0 else wrap_angle(navigation.alpha - math.pi)


def choose_direction(navigation: Navigation) -> float:
    """Return the direction of travel, 1 or -1, that needs less turning at the start and at the goal."""
    forwards = abs(navigation.alpha) + abs(navigation.beta)
    backwards = abs(wrap_angle(navigation.alpha - math.pi)) + abs(wrap_angle(navigation.beta - math.pi))
    return 1.0 if forwards <= backwards else -1.0


def step_of(decide: Callable[[Any, Situation, Any], tuple[Any, Twist]]) -> Any:
    """Return the function ``step`` of a law. ``decide`` returns the next state and the requested command."""

    def step(memory: LawMemory, observation: Observation, goal: Pose, config: Any) -> tuple[LawMemory, Twist, Report]:
        """Answer one pose, see :meth:`diffbot_control.law.law.Law.step`."""
        now = situation_of(memory, observation, goal, config.data_sheet)
        state, requested = decide(memory.state, now, config)
        return conclude(state, requested, now, config.tolerance, config.data_sheet)

    # Each function needs its own name, because functions of the same name would share an entry in numba's cache.
    step.__qualname__ = f"step_of_{decide.__name__}"
    return step


class PeerLaw(Law):
    """Base class of the laws whose memory is a :class:`LawMemory` and whose Config has a ``data_sheet``."""

    @staticmethod
    def new_memory(config: Any) -> LawMemory:
        """Return the memory of a robot at rest with a new goal."""
        return new_law_memory()

    @classmethod
    def memory_for_new_goal(cls, memory: Any, config: Any) -> LawMemory:
        """Return a new memory with the current motion, for the limits of acceleration and the prediction."""
        new: LawMemory = cls.new_memory(config)
        return new._replace(command=memory.command, actuation=memory.actuation)

    @staticmethod
    def after_command(memory: Any, command: Twist, dt: float, config: Any) -> LawMemory:
        """Store the new command and the motion, and restart the count of consecutive poses within the tolerances."""
        actuation = after_a_period(memory.actuation, memory.command, dt, config.data_sheet)
        after: LawMemory = memory._replace(command=command, actuation=actuation)
        return after._replace(settling=after.settling._replace(steps_within=0))
