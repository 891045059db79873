"""The controller: one step as a pure function with its memory as argument and result."""

from __future__ import annotations

import math
from typing import NamedTuple

from diffbot_control.geometry import Pose, into_frame
from diffbot_control.goal import GoalTolerance, within
from diffbot_control.kinematics import Twist, WheelGeometry
from diffbot_control.laws import (
    Gains,
    global_law,
    global_lyapunov,
    local_law,
    local_lyapunov,
)
from diffbot_control.limits import Limits, limit_acceleration, limit_velocity
from diffbot_control.navigation import navigation_variables
from diffbot_control.regions import OMEGA_G, OMEGA_L, FixedRegion, fixed_region


class ControllerConfig(NamedTuple):
    """All that shapes the command."""

    gains: Gains = Gains()
    region: FixedRegion = FixedRegion()
    limits: Limits = Limits()
    wheels: WheelGeometry = WheelGeometry()
    tolerance: GoalTolerance = GoalTolerance()


class ControllerMemory(NamedTuple):
    """What one step leaves to the next; the default is the state at a new goal."""

    region: int = OMEGA_G
    v: float = 0.0
    """[m/s] last command"""
    omega: float = 0.0
    """[rad/s] last command"""
    steps_within: int = 0
    """steps in a row inside the tolerances"""
    reached: bool = False
    switches: int = 0
    """changes of region so far; entering Omega_L counts as one"""


class Report(NamedTuple):
    """What the step saw and decided, for ~/navigation and the records."""

    rho: float
    """[m]"""
    alpha: float
    """[rad]"""
    beta: float
    """[rad]"""
    theta: float
    """[rad] heading in the goal's frame"""
    eps_P: float
    """[m] radius at which the region would change from here"""
    region: int
    lyapunov: float
    """V of Eq. (8) in Omega_G, of Eq. (15) in Omega_L"""


def memory_for_new_goal(memory: ControllerMemory) -> ControllerMemory:
    """Forget the old goal but not the motion: the acceleration limits hold across goals."""
    return ControllerMemory(v=memory.v, omega=memory.omega)


def step(
    memory: ControllerMemory, pose: Pose, goal: Pose, dt: float, config: ControllerConfig
) -> tuple[ControllerMemory, Twist, Report]:
    """Law (17) for any goal pose, within the limits.

    Args:
        memory: as left by the last step.
        pose: estimate of the robot's pose, in the frame of ``goal``.
        goal: where to go.
        dt: [s] since the last step, for the acceleration limits; 0 lets no velocity change if those are set.
        config: gains, policy, limits, tolerances.

    Returns:
        The next memory, the command, and what was seen. The command is zero if the numbers overflow.
    """
    local = into_frame(pose, goal)
    navigation = navigation_variables(local)
    region = fixed_region(memory.region, navigation.rho, config.region)
    if region == OMEGA_L:
        wanted = local_law(navigation, local.theta, config.gains)
        lyapunov = local_lyapunov(navigation, local.theta)
        radius = config.region.eps_P_leave
    else:
        wanted = global_law(navigation, config.gains)
        lyapunov = global_lyapunov(navigation, config.gains)
        radius = config.region.eps_P
    limited = limit_velocity(wanted, config.limits, config.wheels)
    command = limit_acceleration(limited, Twist(memory.v, memory.omega), dt, config.limits)
    if not (math.isfinite(command.v) and math.isfinite(command.omega)):
        command = Twist(0.0, 0.0)
    inside = within(local, navigation.rho, command, config.tolerance)
    steps_within = memory.steps_within + 1 if inside else 0
    reached = steps_within >= config.tolerance.settling_steps or (config.tolerance.stateful and memory.reached)
    switches = memory.switches + (1 if region != memory.region else 0)
    report = Report(navigation.rho, navigation.alpha, navigation.beta, local.theta, radius, region, lyapunov)
    return (
        ControllerMemory(region, command.v, command.omega, steps_within, reached, switches),
        command,
        report,
    )


def stop_step(memory: ControllerMemory, dt: float, config: ControllerConfig) -> tuple[ControllerMemory, Twist]:
    """One step of coming to rest without a goal: zero at once, or as the acceleration limits allow."""
    command = limit_acceleration(Twist(0.0, 0.0), Twist(memory.v, memory.omega), dt, config.limits)
    return memory._replace(v=command.v, omega=command.omega), command
