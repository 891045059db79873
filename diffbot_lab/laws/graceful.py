"""The smooth law of Park and Kuipers with rotations in place and finish as in Nav2's graceful controller."""

from __future__ import annotations

import math
from typing import Annotated, Any, NamedTuple

from diffbot_control.law.configuration import Report
from diffbot_control.law.goal_checker import GoalTolerance
from diffbot_core.data_sheet import DataSheet
from diffbot_core.geometry import Pose, wrap_angle
from diffbot_core.kinematics import Twist
from diffbot_core.schema import Spec
from diffbot_core.uncertainty import Estimate
from diffbot_lab.laws.common import (
    DRIVING,
    FINISHING,
    ROTATING,
    LawMemory,
    LawState,
    Situation,
    Stop,
    Turning,
    approach_speed,
    bearing,
    chosen_direction,
    conclude,
    final_turn,
    new_law_memory,
    situation_of,
    turn_rate,
)

_NEAR = 1e-9
"""[m] below it a curvature 1 / r is taken at this distance"""


class GracefulConfig(NamedTuple):
    """Parameters under their names in Nav2's parameter_handler.cpp (github.com/ros-navigation/navigation2).

    It heads for the goal itself, forwards or backwards, brakes and turns within the data sheet, and looks ahead over
    latencies. Nav2's controller as it is: :mod:`diffbot_lab.laws.nav2_graceful`.
    """

    prefer_final_rotation: Annotated[
        bool, Spec("head straight for the goal and turn to its heading at the end; otherwise drive to the pose")
    ] = True
    v_linear_max: Annotated[float, Spec("bound of the speed", "m/s", 0.01, 10.0)] = 1.3
    v_linear_min: Annotated[float, Spec("least speed", "m/s", 0.0, 1.0)] = 0.025
    k_phi: Annotated[float, Spec("k_1 of Park and Kuipers", "-", 0.0, 20.0)] = 0.5
    k_delta: Annotated[float, Spec("k_2 of Park and Kuipers", "-", 0.0, 20.0)] = 2.1
    beta: Annotated[float, Spec("weight of the curvature in the speed", "m^lambda", 0.0, 10.0)] = 0.24
    lambda_: Annotated[float, Spec("exponent of the curvature in the speed", "-", 0.5, 5.0, parameter="lambda")] = 1.8
    slowdown_radius: Annotated[float, Spec("the speed falls in proportion below this distance", "m", 0.05, 10.0)] = 1.5
    initial_rotation_tolerance: Annotated[
        float, Spec("bearing below which the initial rotation ends", "rad", 0.01, 3.2)
    ] = 0.9
    turning: Turning = Turning(5.7, 0.48)
    stop: Stop = Stop(0.02, 0.012)
    tolerance: GoalTolerance = GoalTolerance()
    data_sheet: DataSheet = DataSheet()


def graceful_curvature(r: float, phi: float, delta: float, k_phi: float, k_delta: float) -> float:
    """Curvature [1/m] that brings the heading onto the manifold delta = atan(-k_phi phi), and along it to the target.

    Source: J. J. Park and B. Kuipers, "A smooth control law for graceful motion of differential wheeled mobile robots
    in 2D environment", ICRA 2011, Eq. (13) with omega = curvature v.

    Args:
        r: [m] distance of the target.
        phi: [rad] heading of the target relative to the line of sight.
        delta: [rad] heading of the robot relative to the line of sight.
        k_phi: [-] k_1 there.
        k_delta: [-] k_2 there.
    """
    fast = k_delta * (delta + math.atan(k_phi * phi))
    along = (1.0 + k_phi / (1.0 + (k_phi * phi) ** 2)) * math.sin(delta)
    return -(fast + along) / max(r, _NEAR)


def graceful_slowdown(
    r: float, curvature: float, v_max: float, beta: float, lambda_: float, slowdown_radius: float
) -> float:
    """Speed [m/s] for a curvature [1/m] at distance ``r`` [m] of the target, without a least speed.

    Source: Park and Kuipers, ICRA 2011, Eq. (15), v = v_max / (1 + beta |curvature|^lambda); slowing down near the
    target: Nav2's smooth_control_law.cpp.
    """
    v: float = min(v_max / (1.0 + beta * abs(curvature) ** lambda_), v_max * r / slowdown_radius)
    return v


def graceful_speed(r: float, curvature: float, config: GracefulConfig) -> float:
    """Speed [m/s] as in Nav2 (:func:`graceful_slowdown`, then a least speed), and slow enough to brake in time."""
    v_max = min(config.v_linear_max, config.data_sheet.v_max)
    v = graceful_slowdown(r, curvature, v_max, config.beta, config.lambda_, config.slowdown_radius)
    return min(max(min(v, approach_speed(r, config.data_sheet)), config.v_linear_min), v_max)


def graceful(state: LawState, now: Situation, config: GracefulConfig) -> tuple[LawState, Twist]:
    """Return the next state and the requested command."""
    sheet = config.data_sheet
    rho, _, beta = now.navigation
    direction = state.direction if state.direction != 0.0 else chosen_direction(now.navigation)
    if state.phase >= FINISHING or rho < config.stop.stop_distance:
        finishing = LawState(max(state.phase, FINISHING), direction, 0.0)
        return final_turn(finishing, now.pose.theta, config.stop, config.turning, sheet)
    angle = bearing(now.navigation, direction)
    if state.phase == ROTATING and abs(angle) >= config.initial_rotation_tolerance:
        return LawState(ROTATING, direction, 0.0), Twist(0.0, turn_rate(angle, config.turning, sheet))
    # Backwards the robot is one that faces the other way, and so does its goal.
    half_turn = 0.0 if direction > 0.0 else math.pi
    phi = 0.0 if config.prefer_final_rotation else wrap_angle(half_turn - beta)
    curvature = graceful_curvature(rho, phi, -angle, config.k_phi, config.k_delta)
    v = graceful_speed(rho, curvature, config)
    return LawState(DRIVING, direction, 0.0), Twist(direction * v, curvature * v)


def graceful_memory(config: Any) -> LawMemory:
    """Return the memory at rest with a new goal."""
    return new_law_memory()


def graceful_step(
    memory: LawMemory, estimate: Estimate, goal: Pose, dt: float, config: GracefulConfig
) -> tuple[LawMemory, Twist, Report]:
    """One step of the law."""
    now = situation_of(memory, estimate, goal, dt, config.data_sheet)
    state, requested = graceful(memory.state, now, config)
    return conclude(state, requested, now, config.tolerance, config.data_sheet)


class Graceful:
    """J. J. Park, B. Kuipers, ICRA 2011, as used by Nav2's graceful controller."""

    name = "graceful"
    Config = GracefulConfig
    new_memory = staticmethod(graceful_memory)
    step = staticmethod(graceful_step)
