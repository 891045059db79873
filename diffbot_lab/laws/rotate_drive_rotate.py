"""Turn towards the goal, drive straight to it, and turn to its heading, as most robots do."""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from diffbot_control.law.goal_checker import GoalTolerance
from diffbot_control.law.steering import braking
from diffbot_core.data_sheet import DataSheet, rim_speed
from diffbot_core.kinematics import Twist
from diffbot_core.schema import Spec
from diffbot_lab.laws import common

_PASSED = 0.5
"""[m] distance within which the drive ends as soon as the goal is behind the robot"""
_OFF_LINE = 0.7
"""[rad] bearing above which the robot turns without driving"""
_NEAR = 0.3
"""[m] distance below which the steering is reduced, because the bearing is too noisy there"""


class RotateDriveRotateConfig(NamedTuple):
    """Parameters of the two turns and of the drive."""

    turning: common.Turning = common.Turning()
    stop: common.Stop = common.Stop()
    drive_brake: Annotated[float, Spec("deceleration of the drive", "m/s^2", 0.05, 100.0)] = 5.0
    drive_time: Annotated[float, Spec("reaction time of the drive", "s", 0.02, 10.0)] = 1.0
    slow_distance: Annotated[float, Spec("length of a slow end of the drive; 0: none", "m", 0.0, 5.0)] = 0.0
    slow_slope: Annotated[float, Spec("speed divided by distance on the slow end", "1/s", 0.0, 10.0)] = 0.0
    start_angle: Annotated[float, Spec("bearing below which the drive begins", "rad", 0.01, 1.5)] = 0.2
    line_gain: Annotated[float, Spec("steering gain of the drive", "1/s", 0.01, 50.0)] = 4.0
    tolerance: GoalTolerance = GoalTolerance()
    data_sheet: DataSheet = DataSheet()


def rotate_drive_rotate(
    state: common.PeerState, now: common.Situation, config: RotateDriveRotateConfig
) -> tuple[common.PeerState, Twist]:
    """Return the next state and the requested command."""
    sheet = config.data_sheet
    rho = now.navigation.rho
    direction = state.direction if state.direction != 0.0 else common.choose_direction(now.navigation)
    angle = common.bearing(now.navigation, direction)
    if state.phase >= common.FINISHING:
        return common.final_turn(state, now.pose.theta, config)
    if state.phase == common.ROTATING and abs(angle) >= config.start_angle:
        return common.PeerState(common.ROTATING, direction, 0.0), Twist(
            0.0, common.turn_rate(angle, config.turning, sheet)
        )
    if rho < config.stop.stop_distance or (rho < _PASSED and abs(angle) > 0.5 * math.pi):
        return common.final_turn(common.PeerState(common.FINISHING, direction, 0.0), now.pose.theta, config)
    line = common.Turning(config.turning.turn_brake, 1.0 / config.line_gain)
    omega = common.turn_rate(angle, line, sheet) * min(1.0, rho / _NEAR)
    v = 0.0 if abs(angle) > _OFF_LINE else _drive_speed(rho, config) * math.cos(angle)
    v = min(v, max(rim_speed(sheet) - 0.5 * sheet.wheels.wheel_separation * abs(omega), 0.0))
    return common.PeerState(common.DRIVING, direction, 0.0), Twist(direction * v, omega)


def _drive_speed(rho: float, config: RotateDriveRotateConfig) -> float:
    fast = braking(max(rho - config.slow_distance, 0.0), config.drive_brake, config.drive_time)
    return min(config.data_sheet.v_max, config.slow_slope * rho + fast, common.approach_speed(rho, config.data_sheet))


class RotateDriveRotate(common.PeerLaw):
    """Rotate, drive, rotate, with or without a slow end. Source: common practice, for example Nav2's rotation shim."""

    name = "rotate_drive_rotate"
    Config = RotateDriveRotateConfig
    step = staticmethod(common.step_of(rotate_drive_rotate))
