"""Dynamic feedback linearisation, with the switching law's Omega_L near the goal."""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from diffbot_control.law.goal_checker import GoalTolerance
from diffbot_control.law.law import Observation, Report
from diffbot_control.law.limits import limit_velocity
from diffbot_control.law.regions import OMEGA_G, OMEGA_L
from diffbot_core.data_sheet import DataSheet
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist
from diffbot_core.schema import Spec
from diffbot_lab.laws import common

_START_SPEED, _MIN_SPEED = 0.15, 0.05
"""[m/s] initial and smallest speed of the integrator. The linearisation is singular at rest"""
_LEAVING = 0.4
"""[m] distance beyond which the law leaves Omega_L"""
_SPEED_SHARE, _BRAKE_SHARE = 0.97, 0.9
"""shares of the limits of speed and acceleration that the linear system uses"""


class FeedbackLinearisationConfig(NamedTuple):
    """Gains of the linear system, and parameters of Omega_L."""

    k_p: Annotated[float, Spec("proportional gain of the linear system", "1/s^2", 0.01, 20.0)] = 1.5
    damping: Annotated[float, Spec("damping ratio of the linear system", "-", 1.001, 5.0)] = 1.02
    along_max: Annotated[float, Spec("limit of the acceleration along the path", "m/s^2", 0.05, 50.0)] = 0.93
    region_sigmas: Annotated[
        float, Spec("radius of Omega_L in standard deviations of the position", "-", 0.0, 10.0)
    ] = 1.2
    region_min: Annotated[float, Spec("smallest radius of Omega_L", "m", 0.0, 1.0)] = 0.04
    near_slope: Annotated[float, Spec("speed per distance in Omega_L", "1/s", 0.0, 20.0)] = 2.3
    turning: common.Turning = common.Turning(6.9, 0.25)
    stop: common.Stop = common.Stop(0.05, 0.05)
    tolerance: GoalTolerance = GoalTolerance()
    data_sheet: DataSheet = DataSheet()


def feedback_linearisation(
    state: common.PeerState, now: common.Situation, config: FeedbackLinearisationConfig
) -> tuple[common.PeerState, Twist]:
    """Return the next state and the requested command. The value of the state is the speed [m/s] of the integrator.

    Source: G. Oriolo, A. De Luca, M. Vendittelli, "WMR control via dynamic feedback linearization", IEEE Transactions
    on Control Systems Technology 10 (2002), posture regulation; law (17) of the paper inside Omega_L.
    """
    rho = now.navigation.rho
    direction, speed = state.direction, state.value
    local = state.phase >= common.FINISHING
    if not local and rho < max(config.region_min, config.region_sigmas * now.uncertainty.xy):
        local = True
    elif direction == 0.0 or (local and rho > _LEAVING):
        local, direction = False, common.choose_direction(now.navigation)
        speed = direction * _START_SPEED
    if local:
        return _in_region(state, now, config)
    along, across = _acceleration(now.pose, speed, config)
    speed = min(max(speed + now.dt * along, -config.data_sheet.v_max), config.data_sheet.v_max)
    if abs(speed) < _MIN_SPEED:
        speed = math.copysign(_MIN_SPEED, direction)
    limit = config.data_sheet.omega_max
    requested = limit_velocity(Twist(speed, min(max(across / speed, -limit), limit)), config.data_sheet)
    if abs(requested.v) >= _MIN_SPEED:
        speed = requested.v
    return common.PeerState(common.DRIVING, direction, speed), requested


def _acceleration(pose: Pose, speed: float, config: FeedbackLinearisationConfig) -> tuple[float, float]:
    """Return the accelerations [m/s^2] of the linear system along and across the robot."""
    sheet = config.data_sheet
    c, s = math.cos(pose.theta), math.sin(pose.theta)
    k_d = 2.0 * config.damping * math.sqrt(config.k_p)
    # Saturate the position error so that the linear system does not exceed v_max.
    rho = max(math.hypot(pose.x, pose.y), 1e-9)
    k_p = config.k_p * min(1.0, _SPEED_SHARE * sheet.v_max * k_d / (config.k_p * rho))
    a_x = -k_p * pose.x - k_d * speed * c
    a_y = -k_p * pose.y - k_d * speed * s
    limit = min(config.along_max, _BRAKE_SHARE * sheet.a_max)
    return min(max(a_x * c + a_y * s, -limit), limit), a_y * c - a_x * s


def _in_region(
    state: common.PeerState, now: common.Situation, config: FeedbackLinearisationConfig
) -> tuple[common.PeerState, Twist]:
    rho, alpha, _ = now.navigation
    inside = rho < config.stop.stop_distance and abs(now.pose.theta) < config.stop.stop_angle
    phase = common.REACHED if inside or state.phase == common.REACHED else common.FINISHING
    v = min(config.near_slope * rho, config.data_sheet.v_max) * math.cos(alpha)
    omega = -common.turn_rate(now.pose.theta, config.turning, config.data_sheet)
    return common.PeerState(phase, state.direction, state.value), Twist(v, omega)


class FeedbackLinearisation(common.PeerLaw):
    """G. Oriolo et al., IEEE Trans. Control Systems Technology 10 (2002), with Omega_L of the switching law."""

    name = "feedback_linearisation"
    Config = FeedbackLinearisationConfig

    @staticmethod
    def step(
        memory: common.LawMemory, observation: Observation, goal: Pose, config: FeedbackLinearisationConfig
    ) -> tuple[common.LawMemory, Twist, Report]:
        """Answer one pose."""
        now = common.situation_of(memory, observation, goal, config.data_sheet)
        state, requested = feedback_linearisation(memory.state, now, config)
        region = OMEGA_L if state.phase >= common.FINISHING else OMEGA_G
        return common.conclude(state, requested, now, config.tolerance, config.data_sheet, region)
