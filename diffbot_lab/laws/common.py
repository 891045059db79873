"""What all laws of this room share: memory, situation, braking, limits, the turn at the end."""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from diffbot_control.law.configuration import Report
from diffbot_control.law.latency import Actuation, coast, is_immediate, resting_actuation
from diffbot_control.law.polar_coordinates import Navigation, navigation_variables
from diffbot_control.law.regions import OMEGA_G
from diffbot_core.data_sheet import DataSheet
from diffbot_core.geometry import Pose, into_frame, wrap_angle
from diffbot_core.kinematics import Twist, WheelGeometry
from diffbot_core.schema import Spec
from diffbot_core.uncertainty import Estimate

ROTATING, DRIVING, FINISHING, REACHED = 0, 1, 2, 3
"""Phases: turning towards the goal, driving there, turning to the goal's heading, holding still."""
_BRAKE_SHARE, _TURN_SHARE = 0.9, 0.7
"""of the acceleration limits: the profiles brake with less, so that the limits bind at the start only"""
_BRAKE_TIME = 0.1
"""[s] reaction time of braking before the goal"""
_LIFTED_SHARE = 0.4
"""of the least command that moves: from there on a command is raised to it, below it becomes zero"""
_REST_V, _REST_OMEGA, _REST_WAY = 0.05, 0.1, 0.01
"""[m/s], [rad/s], [m] a robot with less rests"""
STOP = Twist(0.0, 0.0)


class Stop(NamedTuple):
    """When a law holds still, by its estimate."""

    stop_distance: Annotated[float, Spec("the position counts as reached below this distance", "m", 0.0, 1.0)] = 0.035
    stop_angle: Annotated[float, Spec("the heading counts as reached below this error", "rad", 0.0, 1.0)] = 0.025


class Turning(NamedTuple):
    """Turns on the spot: the largest rate that stops within the angle left, after a reaction time."""

    turn_brake: Annotated[float, Spec("angular deceleration of turns", "rad/s^2", 0.1, 100.0)] = 8.0
    turn_time: Annotated[
        float, Spec("reaction time of turns; its inverse is the gain near the end", "s", 0.01, 5.0)
    ] = 0.4


class LawState(NamedTuple):
    """What a law itself keeps from step to step; each uses what it needs."""

    phase: int
    direction: float
    """1 forwards, -1 backwards, 0 not chosen yet"""
    value: float
    """of the law's own"""


class LawMemory(NamedTuple):
    """Memory of a law of this room."""

    state: LawState
    actuation: Actuation
    """commands under way"""
    command: Twist
    """the last one"""
    reached: bool


class Situation(NamedTuple):
    """What a law decides on, all in the goal's frame."""

    pose: Pose
    """estimate, coasted over latency and lag"""
    navigation: Navigation
    sigma: float
    """[m] standard deviation of the position"""
    actuation: Actuation
    last: Twist
    """command of the last step"""
    coasting: float
    """[m] from the estimated pose to the coasted one"""
    reached: bool
    """the law reported the goal as reached before"""
    dt: float
    """[s] since the last step"""


def new_law_memory() -> LawMemory:
    """Return the memory at rest with a new goal."""
    return LawMemory(LawState(ROTATING, 0.0, 0.0), resting_actuation(), Twist(0.0, 0.0), False)


def situation_of(memory: LawMemory, estimate: Estimate, goal: Pose, dt: float, sheet: DataSheet) -> Situation:
    """Return the situation at a step."""
    local, actuation = into_frame(estimate.pose, goal), memory.actuation
    pose, coasting = local, 0.0
    if not is_immediate(sheet):
        coasted = coast(local, actuation, memory.command, dt, sheet)
        pose, actuation = coasted.pose, coasted.actuation
        coasting = math.hypot(pose.x - local.x, pose.y - local.y)
    sigma = estimate.uncertainty.xy
    return Situation(pose, navigation_variables(pose), sigma, actuation, memory.command, coasting, memory.reached, dt)


def conclude(
    state: LawState, requested: Twist, situation: Situation, sheet: DataSheet, region: int = OMEGA_G
) -> tuple[LawMemory, Twist, Report]:
    """Bring a requested command within the data sheet; return memory, command and report."""
    command = lifted(limit_speed(requested, sheet), sheet)
    command = limit_change(command, situation.last, situation.dt, sheet)
    if not (math.isfinite(command.v) and math.isfinite(command.omega)):
        command = STOP
    rho, alpha, beta = situation.navigation
    # Said when the robot rests, not while it coasts to the goal.
    at_rest = abs(command.v) <= _REST_V and abs(command.omega) <= _REST_OMEGA and situation.coasting <= _REST_WAY
    reached = situation.reached or (state.phase == REACHED and at_rest)
    report = Report(rho, alpha, beta, situation.pose.theta, 0.0, region, math.nan)
    return LawMemory(state, situation.actuation, command, reached), command, report


def braking_speed(distance: float, brake: float, time: float) -> float:
    """Return the largest speed s that stops within ``distance``: distance = s^2 / (2 brake) + s time.

    Args:
        distance: [m] or [rad], >= 0.
        brake: [m/s^2] or [rad/s^2]; inf: at once.
        time: [s] of reaction.
    """
    if brake == math.inf:
        return distance / time
    return 2.0 * distance / (time + math.sqrt(time * time + 2.0 * distance / brake))


def approach_speed(distance: float, sheet: DataSheet) -> float:
    """Return the speed [m/s] from which the robot can stop within ``distance`` [m]; inf without a limit."""
    if sheet.a_max == math.inf:
        return math.inf
    return braking_speed(distance, _BRAKE_SHARE * sheet.a_max, _BRAKE_TIME)


def turn_rate(angle: float, turning: Turning, sheet: DataSheet) -> float:
    """Return the rate [rad/s] with which to turn by ``angle`` [rad], still to go."""
    brake = min(turning.turn_brake, _TURN_SHARE * sheet.omega_dot_max)
    return math.copysign(min(sheet.omega_max, braking_speed(abs(angle), brake, turning.turn_time)), angle)


def final_turn(state: LawState, theta: float, stop: Stop, turning: Turning, sheet: DataSheet) -> tuple[LawState, Twist]:
    """Turn to the goal's heading, then hold still for good."""
    if state.phase == REACHED or abs(theta) < stop.stop_angle:
        return LawState(REACHED, state.direction, state.value), STOP
    return LawState(FINISHING, state.direction, state.value), Twist(0.0, -turn_rate(theta, turning, sheet))


def bearing(navigation: Navigation, direction: float) -> float:
    """Return the bearing [rad] of the goal from the end of the robot that leads."""
    return navigation.alpha if direction > 0.0 else wrap_angle(navigation.alpha - math.pi)


def chosen_direction(navigation: Navigation) -> float:
    """Return 1 or -1, the direction of travel with less turning at the start and at the goal."""
    forwards = abs(navigation.alpha) + abs(navigation.beta)
    backwards = abs(wrap_angle(navigation.alpha - math.pi)) + abs(wrap_angle(navigation.beta - math.pi))
    return 1.0 if forwards <= backwards else -1.0


def max_rim_speed(sheet: DataSheet) -> float:
    """Return the bound of each rim's speed [m/s]."""
    return sheet.wheel_max * sheet.wheels.wheel_radius


def _rim_speed(v: float, omega: float, wheels: WheelGeometry) -> float:
    return abs(v) + 0.5 * wheels.wheel_separation * abs(omega)


def limit_speed(requested: Twist, sheet: DataSheet) -> Twist:
    """Scale a command down until v, omega and both rims are within bounds; the curvature stays."""
    scale = 1.0
    if abs(requested.v) > sheet.v_max:
        scale = sheet.v_max / abs(requested.v)
    if abs(requested.omega) * scale > sheet.omega_max:
        scale = sheet.omega_max / abs(requested.omega)
    rim = _rim_speed(requested.v, requested.omega, sheet.wheels)
    if rim * scale > max_rim_speed(sheet):
        scale = max_rim_speed(sheet) / rim
    return Twist(requested.v * scale, requested.omega * scale)


def lifted(command: Twist, sheet: DataSheet) -> Twist:
    """Raise what is too small to move the robot to what moves it, or drop it."""
    if sheet.min_velocity <= 0.0 and sheet.min_rotation <= 0.0:
        return command
    return Twist(_lifted(command.v, sheet.min_velocity), _lifted(command.omega, sheet.min_rotation))


def _lifted(value: float, least: float) -> float:
    if abs(value) >= least:
        return value
    return math.copysign(least, value) if abs(value) > _LIFTED_SHARE * least else 0.0


def limit_change(command: Twist, last: Twist, dt: float, sheet: DataSheet) -> Twist:
    """Return the command within the changes that one period allows, its rims within their bound.

    Rotation goes first and the speed gives way, as far as it can in one period; ``last`` is within the bounds, and they
    form a convex set, so a feasible command exists.
    """
    if sheet.a_max == math.inf and sheet.omega_dot_max == math.inf:
        return command
    dv = sheet.a_max * dt if sheet.a_max < math.inf else math.inf
    domega = sheet.omega_dot_max * dt if sheet.omega_dot_max < math.inf else math.inf
    v = min(max(command.v, last.v - dv), last.v + dv)
    omega = min(max(command.omega, last.omega - domega), last.omega + domega)
    rim, half = max_rim_speed(sheet), 0.5 * sheet.wheels.wheel_separation
    if _rim_speed(v, omega, sheet.wheels) > rim:
        slower = max(rim - half * abs(omega), abs(last.v) - dv, 0.0)
        v = min(max(v, -slower), slower)
        room = max(rim - abs(v), 0.0) / half
        omega = min(max(omega, -room), room)
    return Twist(v, omega)
