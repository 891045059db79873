"""Closed-loop steering by Lyapunov techniques: law (13) of the paper all the way, holding still at the goal."""

from __future__ import annotations

import math
from typing import Annotated, Any, NamedTuple

from diffbot_control.law.configuration import Report
from diffbot_control.law.goal_checker import GoalTolerance
from diffbot_control.law.lyapunov_law import sinc
from diffbot_core.data_sheet import DataSheet
from diffbot_core.geometry import Pose
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
    conclude,
    new_law_memory,
    situation_of,
)

_NEAR = 1e-9
"""[m] below it f / rho is taken at this distance"""


class AicardiConfig(NamedTuple):
    """Gains; with slope 1.3, k 1, h 0.17 those of the paper near the goal."""

    slope: Annotated[float, Spec("speed per distance, up to the bound of the speed", "1/s", 0.01, 20.0)] = 1.3
    k: Annotated[float, Spec("weight of alpha", "1/s", 0.01, 50.0)] = 1.0
    h: Annotated[float, Spec("weight of beta", "-", 0.001, 50.0)] = 0.17
    stop: Stop = Stop(0.02, 0.05)
    tolerance: GoalTolerance = GoalTolerance()
    data_sheet: DataSheet = DataSheet()


def aicardi(state: LawState, now: Situation, config: AicardiConfig) -> tuple[LawState, Twist]:
    """Return the next state and the requested command.

    Source: M. Aicardi, G. Casalino, A. Bicchi, A. Balestrino, "Closed loop steering of unicycle-like vehicles via
    Lyapunov techniques", IEEE Robotics and Automation Magazine 2 (1995), with a bounded f(rho) for gamma rho.
    """
    rho, alpha, beta = now.navigation
    inside = rho < config.stop.stop_distance and abs(now.pose.theta) < config.stop.stop_angle
    if state.phase == REACHED or inside:
        return LawState(REACHED, 0.0, 0.0), STOP
    f = min(config.data_sheet.v_max, config.slope * rho, approach_speed(rho, config.data_sheet))
    cosine = math.cos(alpha)
    turn = f / max(rho, _NEAR) * cosine * sinc(alpha) * (alpha + config.h * beta)
    return LawState(DRIVING, 0.0, 0.0), Twist(f * cosine, config.k * alpha + turn)


def aicardi_memory(config: Any) -> LawMemory:
    """Return the memory at rest with a new goal."""
    return new_law_memory()


def aicardi_step(
    memory: LawMemory, estimate: Estimate, goal: Pose, dt: float, config: AicardiConfig
) -> tuple[LawMemory, Twist, Report]:
    """One step of the law."""
    now = situation_of(memory, estimate, goal, dt, config.data_sheet)
    state, requested = aicardi(memory.state, now, config)
    return conclude(state, requested, now, config.tolerance, config.data_sheet)


class Aicardi:
    """M. Aicardi et al., IEEE Robotics and Automation Magazine 2 (1995)."""

    name = "aicardi"
    Config = AicardiConfig
    new_memory = staticmethod(aicardi_memory)
    step = staticmethod(aicardi_step)
