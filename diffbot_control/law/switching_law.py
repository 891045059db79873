"""This project's law behind the common protocol."""

from __future__ import annotations

from typing import NamedTuple

from diffbot_control.law import controller
from diffbot_control.law.controller import ControllerConfig, ControllerMemory, Report
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist
from diffbot_core.uncertainty import Estimate


class SwitchingMemory(NamedTuple):
    """Memory of the controller, and whether the goal is reached."""

    controller: ControllerMemory
    reached: bool


def new_switching_memory(config: ControllerConfig) -> SwitchingMemory:
    """Return the memory at rest with a new goal."""
    return SwitchingMemory(controller.new_memory(), False)


def switching_step(
    memory: SwitchingMemory, estimate: Estimate, goal: Pose, dt: float, config: ControllerConfig
) -> tuple[SwitchingMemory, Twist, Report]:
    """One step of the controller, see :func:`diffbot_control.law.controller.step`."""
    after, command, report = controller.step(memory.controller, estimate.pose, goal, dt, config, estimate.uncertainty)
    return SwitchingMemory(after, after.settling.reached), command, report


class SwitchingLaw:
    """Law (17) of the paper with its regions, limits, re-approach and goal checker."""

    name = "switching"
    Config = ControllerConfig
    new_memory = staticmethod(new_switching_memory)
    step = staticmethod(switching_step)
