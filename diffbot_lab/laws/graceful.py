"""The smooth law of Park and Kuipers, with the turns on the spot and the finish of Nav2's graceful controller."""

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
"""[m] lower bound of r in the curvature, which is proportional to 1 / r"""


class GracefulConfig(NamedTuple):
    """Parameters, with the names of Nav2's parameter_handler.cpp (github.com/ros-navigation/navigation2).

    Unlike Nav2's controller (:mod:`diffbot_lab.laws.nav2_graceful`), this law drives directly to the goal, forwards or
    backwards. It brakes and turns within the limits of the data sheet, and predicts over latencies.
    """

    prefer_final_rotation: Annotated[bool, Spec("drive to the position and turn there; false: to the pose")] = True
    v_linear_max: Annotated[float, Spec("largest speed", "m/s", 0.01, 10.0)] = 1.3
    v_linear_min: Annotated[float, Spec("smallest speed", "m/s", 0.0, 1.0)] = 0.025
    k_phi: Annotated[float, Spec("k_1 of Park and Kuipers", "-", 0.0, 20.0)] = 0.5
    k_delta: Annotated[float, Spec("k_2 of Park and Kuipers", "-", 0.0, 20.0)] = 2.1
    beta: Annotated[float, Spec("weight of the curvature in the speed", "m^lambda", 0.0, 10.0)] = 0.24
    lambda_: Annotated[float, Spec("exponent of the curvature in the speed", "-", 0.5, 5.0, parameter="lambda")] = 1.8
    slowdown_radius: Annotated[float, Spec("distance below which the speed is proportional to it", "m", 0.05, 10.0)] = (
        1.5
    )
    initial_rotation_tolerance: Annotated[float, Spec("bearing at which the first turn ends", "rad", 0.01, 3.2)] = 0.9
    turning: common.Turning = common.Turning(5.7, 0.48)
    stop: common.Stop = common.Stop(0.02, 0.012)
    tolerance: GoalTolerance = GoalTolerance()
    data_sheet: DataSheet = DataSheet()


def graceful_curvature(r: float, phi: float, delta: float, k_phi: float, k_delta: float) -> float:
    """Return the curvature [1/m] that leads to the manifold delta = atan(-k_phi phi), and along it to the target.

    Source: J. J. Park and B. Kuipers, "A smooth control law for graceful motion of differential wheeled mobile robots
    in 2D environment", ICRA 2011, Eq. (13) with omega = curvature v.

    Args:
        r: [m] distance of the target.
        phi: [rad] heading of the target relative to the line of sight.
        delta: [rad] heading of the robot relative to the line of sight.
        k_phi: [-] k_1 of the source.
        k_delta: [-] k_2 of the source.
    """
    fast = k_delta * (delta + math.atan(k_phi * phi))
    along = (1.0 + k_phi / (1.0 + (k_phi * phi) ** 2)) * math.sin(delta)
    return -(fast + along) / max(r, _NEAR)


def graceful_slowdown(
    r: float, curvature: float, v_max: float, beta: float, lambda_: float, slowdown_radius: float
) -> float:
    """Return the speed [m/s] for a curvature [1/m] at the distance ``r`` [m] from the target. It has no lower bound.

    Source: Park and Kuipers, ICRA 2011, Eq. (15), v = v_max / (1 + beta |curvature|^lambda); slowing down near the
    target: Nav2's smooth_control_law.cpp.
    """
    v: float = min(v_max / (1.0 + beta * abs(curvature) ** lambda_), v_max * r / slowdown_radius)
    return v


def graceful_speed(r: float, curvature: float, config: GracefulConfig) -> float:
    """Return the speed [m/s] of :func:`graceful_slowdown`, reduced to brake in time, but at least ``v_linear_min``."""
    v_max = min(config.v_linear_max, config.data_sheet.v_max)
    v = graceful_slowdown(r, curvature, v_max, config.beta, config.lambda_, config.slowdown_radius)
    return min(max(min(v, common.approach_speed(r, config.data_sheet)), config.v_linear_min), v_max)


def graceful(state: common.PeerState, now: common.Situation, config: GracefulConfig) -> tuple[common.PeerState, Twist]:
    """Return the next state and the requested command."""
    sheet = config.data_sheet
    rho, _, beta = now.navigation
    direction = state.direction if state.direction != 0.0 else common.choose_direction(now.navigation)
    if state.phase >= common.FINISHING or rho < config.stop.stop_distance:
        finishing = common.PeerState(max(state.phase, common.FINISHING), direction, 0.0)
        return common.final_turn(finishing, now.pose.theta, config)
    angle = common.bearing(now.navigation, direction)
    if state.phase == common.ROTATING and abs(angle) >= config.initial_rotation_tolerance:
        return common.PeerState(common.ROTATING, direction, 0.0), Twist(
            0.0, common.turn_rate(angle, config.turning, sheet)
        )
    # For a robot that drives backwards, turn robot and goal by pi.
    half_turn = 0.0 if direction > 0.0 else math.pi
    phi = 0.0 if config.prefer_final_rotation else wrap_angle(half_turn - beta)
    curvature = graceful_curvature(rho, phi, -angle, config.k_phi, config.k_delta)
    v = graceful_speed(rho, curvature, config)
    return common.PeerState(common.DRIVING, direction, 0.0), Twist(direction * v, curvature * v)


class Graceful(common.PeerLaw):
    """J. J. Park, B. Kuipers, ICRA 2011, as in Nav2's graceful controller."""

    name = "graceful"
    Config = GracefulConfig
    step = staticmethod(common.step_of(graceful))
