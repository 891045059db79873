"""The smooth law of Park and Kuipers with rotations in place and finish as in Nav2's graceful controller."""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from diffbot_control.law.goal_checker import GoalTolerance
from diffbot_core.data_sheet import DataSheet
from diffbot_core.geometry import wrap_angle
from diffbot_core.kinematics import Twist
from diffbot_core.schema import Spec
from diffbot_lab.laws import common

_NEAR = 1e-9
"""[m] below it a curvature 1 / r is taken at this distance"""


class GracefulConfig(NamedTuple):
    """Parameters under their names in Nav2's parameter_handler.cpp (github.com/ros-navigation/navigation2).

    It heads for the goal itself, forwards or backwards, brakes and turns within the data sheet, and looks ahead over
    latencies. Nav2's controller as it is: :mod:`diffbot_lab.laws.nav2_graceful`.
    """

    prefer_final_rotation: Annotated[bool, Spec("head for the goal and turn at the end, or drive to the pose")] = True
    v_linear_max: Annotated[float, Spec("bound of the speed", "m/s", 0.01, 10.0)] = 1.3
    v_linear_min: Annotated[float, Spec("least speed", "m/s", 0.0, 1.0)] = 0.025
    k_phi: Annotated[float, Spec("k_1 of Park and Kuipers", "-", 0.0, 20.0)] = 0.5
    k_delta: Annotated[float, Spec("k_2 of Park and Kuipers", "-", 0.0, 20.0)] = 2.1
    beta: Annotated[float, Spec("weight of the curvature in the speed", "m^lambda", 0.0, 10.0)] = 0.24
    lambda_: Annotated[float, Spec("exponent of the curvature in the speed", "-", 0.5, 5.0, parameter="lambda")] = 1.8
    slowdown_radius: Annotated[float, Spec("the speed falls in proportion below this distance", "m", 0.05, 10.0)] = 1.5
    initial_rotation_tolerance: Annotated[float, Spec("the first turn ends below this bearing", "rad", 0.01, 3.2)] = 0.9
    turning: common.Turning = common.Turning(5.7, 0.48)
    stop: common.Stop = common.Stop(0.02, 0.012)
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
    return min(max(min(v, common.approach_speed(r, config.data_sheet)), config.v_linear_min), v_max)


def graceful(state: common.PeerState, now: common.Situation, config: GracefulConfig) -> tuple[common.PeerState, Twist]:
    """Return the next state and the requested command."""
    sheet = config.data_sheet
    rho, _, beta = now.navigation
    direction = state.direction if state.direction != 0.0 else common.chosen_direction(now.navigation)
    if state.phase >= common.FINISHING or rho < config.stop.stop_distance:
        finishing = common.PeerState(max(state.phase, common.FINISHING), direction, 0.0)
        return common.final_turn(finishing, now.pose.theta, config)
    angle = common.bearing(now.navigation, direction)
    if state.phase == common.ROTATING and abs(angle) >= config.initial_rotation_tolerance:
        return common.PeerState(common.ROTATING, direction, 0.0), Twist(
            0.0, common.turn_rate(angle, config.turning, sheet)
        )
    # Backwards the robot is one that faces the other way, and so does its goal.
    half_turn = 0.0 if direction > 0.0 else math.pi
    phi = 0.0 if config.prefer_final_rotation else wrap_angle(half_turn - beta)
    curvature = graceful_curvature(rho, phi, -angle, config.k_phi, config.k_delta)
    v = graceful_speed(rho, curvature, config)
    return common.PeerState(common.DRIVING, direction, 0.0), Twist(direction * v, curvature * v)


class Graceful(common.PeerLaw):
    """J. J. Park, B. Kuipers, ICRA 2011, as used by Nav2's graceful controller."""

    name = "graceful"
    Config = GracefulConfig
    step = staticmethod(common.step_of(graceful))
