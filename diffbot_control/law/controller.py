"""The controller: one step as a pure function with its memory as argument and result."""

from __future__ import annotations

from diffbot_control.law.braking_step import braking_step
from diffbot_control.law.configuration import (
    BRAKING,
    ControllerConfig,
    ControllerMemory,
    Driving,
    Report,
    new_memory,
)
from diffbot_control.law.latency import after_a_period, is_immediate
from diffbot_control.law.limits import slowed
from diffbot_control.law.paper.step import paper_step
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist
from diffbot_core.uncertainty import Estimate, Uncertainty

__all__ = [
    "ControllerConfig",
    "ControllerMemory",
    "Driving",
    "Report",
    "SwitchingLaw",
    "new_memory",
    "step",
    "stop_step",
]


def step(
    memory: ControllerMemory, estimate: Estimate, goal: Pose, dt: float, config: ControllerConfig
) -> tuple[ControllerMemory, Twist, Report]:
    """Drive towards ``goal`` for one period, within the limits.

    Args:
        memory: as left by the last step.
        estimate: pose of the robot in the frame of ``goal``, and how well it is known.
        goal: target pose.
        dt: [s] since the last step; 0 permits no change of a velocity whose acceleration is limited.
        config: law, gains, policy, data sheet, tolerances.

    Returns:
        The next memory, the command and the report. The command is zero if the numbers overflow.
    """
    if config.uncertainty_scale != 1.0:
        scale, uncertainty = config.uncertainty_scale, estimate.uncertainty
        estimate = Estimate(estimate.pose, Uncertainty(scale * uncertainty.xy, scale * uncertainty.theta))
    if config.profile == BRAKING:
        return braking_step(memory, estimate, goal, dt, config)
    return paper_step(memory, estimate, goal, dt, config)


def stop_step(memory: ControllerMemory, dt: float, config: ControllerConfig) -> tuple[ControllerMemory, Twist]:
    """One step of coming to rest without a goal: zero at once, or along the curve within the limits of acceleration."""
    command = slowed(memory.command, dt, config.data_sheet)
    actuation = memory.actuation
    if not is_immediate(config.data_sheet):
        actuation = after_a_period(actuation, memory.command, dt, config.data_sheet)
    return memory._replace(command=command, actuation=actuation), command


class SwitchingLaw:
    """This project's law in the form of :class:`diffbot_control.goals.protocol.Law`."""

    name = "switching"
    Config = ControllerConfig

    @staticmethod
    def new_memory(config: ControllerConfig) -> ControllerMemory:
        """Return the memory at rest with a new goal."""
        return new_memory()

    step = staticmethod(step)
