"""Regulated pure pursuit of the straight line to the goal, with a turn on the spot before and after."""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from diffbot_control.law.goal_checker import GoalTolerance
from diffbot_core.data_sheet import DataSheet
from diffbot_core.geometry import Pose, into_frame
from diffbot_core.kinematics import Twist
from diffbot_core.schema import Spec
from diffbot_lab.laws import common

_PAST_GOAL = 0.05
"""[m] distance beyond the goal, along the line, at which the drive ends"""
_MIN_SQUARE = 0.02
"""[m^2] smallest squared distance of the carrot in the curvature"""
_MAX_LOOKAHEAD = 3.0
"""[m]"""


class PurePursuitConfig(NamedTuple):
    """Parameters, with the names of Nav2's regulated pure pursuit controller and rotation shim."""

    turning: common.Turning = common.Turning(8.6, 0.45)
    stop: common.Stop = common.Stop(0.044, 0.023)
    lookahead_time: Annotated[float, Spec("lookahead distance divided by the speed", "s", 0.05, 10.0)] = 2.0
    min_lookahead_dist: Annotated[float, Spec("smallest lookahead distance", "m", 0.05, 5.0)] = 0.57
    approach_velocity_scaling_dist: Annotated[
        float, Spec("distance below which the speed is proportional to it", "m", 0.05, 5.0)
    ] = 1.5
    min_approach_linear_velocity: Annotated[float, Spec("smallest speed of the approach", "m/s", 0.0, 1.0)] = 0.12
    regulated_linear_scaling_min_radius: Annotated[
        float, Spec("radius below which curves reduce the speed", "m", 0.01, 10.0)
    ] = 0.1
    angular_dist_threshold: Annotated[float, Spec("bearing at which the first turn ends", "rad", 0.01, 3.2)] = 0.63
    tolerance: GoalTolerance = GoalTolerance()
    data_sheet: DataSheet = DataSheet()


def pure_pursuit(
    state: common.PeerState, now: common.Situation, config: PurePursuitConfig
) -> tuple[common.PeerState, Twist]:
    """Return the next state and the requested command. The value of the state is the direction [rad] of the line.

    Source: S. Macenski, S. Singh, F. Martin, J. Gines, "Regulated pure pursuit for robot path tracking", Autonomous
    Robots 47 (2023). The first turn is the turn of Nav2's rotation shim controller. The path is the straight line from
    the first pose to the goal.
    """
    sheet = config.data_sheet
    rho, _, beta = now.navigation
    direction, line = state.direction, state.value
    if direction == 0.0:
        direction, line = common.choose_direction(now.navigation), beta
    if state.phase >= common.FINISHING:
        return common.final_turn(state, now.pose.theta, config)
    angle = common.bearing(now.navigation, direction)
    if state.phase == common.ROTATING and abs(angle) >= config.angular_dist_threshold:
        return common.PeerState(common.ROTATING, direction, line), Twist(
            0.0, common.turn_rate(angle, config.turning, sheet)
        )
    left = -(now.pose.x * math.cos(line) + now.pose.y * math.sin(line))
    if rho < config.stop.stop_distance or left < -_PAST_GOAL:
        return common.final_turn(common.PeerState(common.FINISHING, direction, line), now.pose.theta, config)
    look = max(config.min_lookahead_dist, min(config.lookahead_time * sheet.v_max, _MAX_LOOKAHEAD))
    ahead = max(left - look, 0.0)
    carrot = into_frame(Pose(-ahead * math.cos(line), -ahead * math.sin(line), 0.0), now.pose)
    curvature = 2.0 * carrot.y / max(carrot.x * carrot.x + carrot.y * carrot.y, _MIN_SQUARE)
    v = direction * _regulated_speed(rho, curvature, config)
    return common.PeerState(common.DRIVING, direction, line), Twist(v, v * curvature)


def _regulated_speed(rho: float, curvature: float, config: PurePursuitConfig) -> float:
    """Return the speed [m/s] for a curvature [1/m], at the distance ``rho`` [m] from the goal."""
    v_max, slowest = config.data_sheet.v_max, config.min_approach_linear_velocity
    v = v_max
    if abs(curvature) * config.regulated_linear_scaling_min_radius > 1.0:
        v /= abs(curvature) * config.regulated_linear_scaling_min_radius
    if rho < config.approach_velocity_scaling_dist:
        v = min(v, max(v_max * rho / config.approach_velocity_scaling_dist, slowest))
    return min(v, max(common.approach_speed(rho, config.data_sheet), slowest))


class PurePursuit(common.PeerLaw):
    """S. Macenski et al., Autonomous Robots 47 (2023), with Nav2's rotation shim."""

    name = "pure_pursuit"
    Config = PurePursuitConfig
    step = staticmethod(common.step_of(pure_pursuit))
