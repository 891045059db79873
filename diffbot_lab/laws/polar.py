"""The linear law in polar coordinates."""

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
    REACHED,
    STOP,
    LawMemory,
    LawState,
    Situation,
    Stop,
    approach_speed,
    bearing,
    chosen_direction,
    conclude,
    new_law_memory,
    situation_of,
)


class PolarConfig(NamedTuple):
    """Gains in the signs of Siegwart and Nourbakhsh; stable for k_rho > 0, k_beta < 0, k_alpha > k_rho.

    The defaults are those of R. Siegwart and I. R. Nourbakhsh, Introduction to Autonomous Mobile Robots, MIT Press,
    section 3.6.2.
    """

    k_rho: Annotated[float, Spec("gain of the distance", "1/s", 0.0, 50.0)] = 3.0
    k_alpha: Annotated[float, Spec("gain of the bearing", "1/s", 0.0, 50.0)] = 8.0
    k_beta: Annotated[float, Spec("gain of the goal's heading", "1/s", -50.0, 0.0)] = -1.5
    stop: Stop = Stop(0.03, 0.05)
    tolerance: GoalTolerance = GoalTolerance()
    data_sheet: DataSheet = DataSheet()


def polar_law(rho: float, alpha: float, beta: float, config: PolarConfig) -> Twist:
    """Drive with v = k_rho rho, omega = k_alpha alpha + k_beta beta, where beta = -theta - alpha.

    Source: A. Astolfi, "Exponential stabilization of a wheeled mobile robot via discontinuous control", ASME Journal
    of Dynamic Systems, Measurement and Control 121 (1999); in the letters of Siegwart and Nourbakhsh, section 3.6.2.

    Args:
        rho: [m] distance of the goal.
        alpha: [rad] its bearing in the robot's frame.
        beta: [rad] minus its bearing in the goal's frame.
        config: gains.
    """
    return Twist(config.k_rho * rho, config.k_alpha * alpha + config.k_beta * beta)


def polar(state: LawState, now: Situation, config: PolarConfig) -> tuple[LawState, Twist]:
    """Return the next state and the requested command; backwards, robot and goal face the other way."""
    rho = now.navigation.rho
    direction = state.direction if state.direction != 0.0 else chosen_direction(now.navigation)
    inside = rho < config.stop.stop_distance and abs(now.pose.theta) < config.stop.stop_angle
    if state.phase == REACHED or inside:
        return LawState(REACHED, direction, 0.0), STOP
    alpha = bearing(now.navigation, direction)
    requested = polar_law(rho, alpha, wrap_angle(-now.pose.theta - alpha), config)
    # Both velocities shrink together, so that braking keeps the curve.
    fastest = min(approach_speed(rho, config.data_sheet), config.data_sheet.v_max)
    scale = min(1.0, fastest / requested.v) if requested.v > 0.0 else 1.0
    scale = 1.0 if math.isinf(fastest) else scale
    return LawState(DRIVING, direction, 0.0), Twist(direction * scale * requested.v, scale * requested.omega)


def polar_memory(config: Any) -> LawMemory:
    """Return the memory at rest with a new goal."""
    return new_law_memory()


def polar_step(
    memory: LawMemory, estimate: Estimate, goal: Pose, dt: float, config: PolarConfig
) -> tuple[LawMemory, Twist, Report]:
    """One step of the law."""
    now = situation_of(memory, estimate, goal, dt, config.data_sheet)
    state, requested = polar(memory.state, now, config)
    return conclude(state, requested, now, config.tolerance, config.data_sheet)


class Polar:
    """A. Astolfi, J. Dyn. Syst. Meas. Control 121 (1999)."""

    name = "polar"
    Config = PolarConfig
    new_memory = staticmethod(polar_memory)
    step = staticmethod(polar_step)
