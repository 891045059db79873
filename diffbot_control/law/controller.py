"""The controller: one step as a pure function with its memory as argument and result."""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from diffbot_control.law.goal_checker import GoalTolerance, Settling, next_settling, within
from diffbot_control.law.limits import Limits, limit_acceleration, limit_velocity
from diffbot_control.law.lyapunov_law import (
    Gains,
    global_law,
    global_lyapunov,
    local_law,
    local_lyapunov,
)
from diffbot_control.law.polar_coordinates import Navigation, navigation_variables
from diffbot_control.law.reapproach import (
    RESTING,
    Reapproach,
    ReapproachConfig,
    next_reapproach,
    reapproach_command,
    without_reapproach,
)
from diffbot_control.law.regions import (
    COVARIANCE,
    OMEGA_G,
    OMEGA_L,
    RegionPolicy,
    Switching,
    forward_only,
    next_switching,
)
from diffbot_core.geometry import Pose, into_frame
from diffbot_core.kinematics import Twist, WheelGeometry
from diffbot_core.schema import Spec
from diffbot_core.uncertainty import CERTAIN, Uncertainty


class Driving(NamedTuple):
    """How the robot may move."""

    allow_backward: Annotated[
        bool, Spec("reverse towards a goal behind the robot; otherwise turn on the spot until it is in front")
    ] = True


class ControllerConfig(NamedTuple):
    """All that shapes the command. The defaults are the preset ``tuned``, as in the node; presets.py has the others."""

    gains: Gains = Gains()
    region_policy: RegionPolicy = RegionPolicy()
    limits: Limits = Limits()
    wheels: WheelGeometry = WheelGeometry()
    tolerance: GoalTolerance = GoalTolerance()
    reapproach: ReapproachConfig = ReapproachConfig()
    driving: Driving = Driving()


class ControllerMemory(NamedTuple):
    """What one step passes to the next; the default is the state at rest with a new goal."""

    switching: Switching = Switching()
    command: Twist = Twist(0.0, 0.0)
    """the last one"""
    settling: Settling = Settling()
    reapproach: Reapproach = Reapproach()


class Report(NamedTuple):
    """The variables of a step and its decisions, for ~/navigation and the records."""

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


def new_memory() -> ControllerMemory:
    """Return the memory at rest with a new goal, every field given: compiled code does not know the defaults."""
    return ControllerMemory(
        switching=Switching(region=OMEGA_G, switches=0, steps_outside=0),
        command=Twist(0.0, 0.0),
        settling=Settling(steps_within=0, reached=False),
        reapproach=Reapproach(phase=RESTING, tries=0, quiet_steps=0, time=0.0, retreat_distance=0.0),
    )


def memory_for_new_goal(memory: ControllerMemory) -> ControllerMemory:
    """Forget the old goal but not the motion: the acceleration limits hold across goals."""
    return ControllerMemory(command=memory.command)


def step(
    memory: ControllerMemory,
    pose: Pose,
    goal: Pose,
    dt: float,
    config: ControllerConfig,
    uncertainty: Uncertainty = CERTAIN,
) -> tuple[ControllerMemory, Twist, Report]:
    """Law (17) for any goal pose, within the limits.

    Args:
        memory: as left by the last step.
        pose: estimate of the robot's pose, in the frame of ``goal``.
        goal: target pose.
        dt: [s] since the last step, for the acceleration limits; 0 permits no change of a limited velocity.
        config: gains, policy, limits, tolerances.
        uncertainty: of the estimate, for the region and the goal; by default the estimate is assumed exact.

    Returns:
        The next memory, the command and the report. The command is zero if the numbers overflow.
    """
    local = into_frame(pose, goal)
    navigation = navigation_variables(local)
    switching, radius = _next_switching(memory, navigation.rho, uncertainty, config)
    if switching.region == OMEGA_L:
        reapproach = _next_reapproach(memory, local, uncertainty, dt, config)
        lyapunov = local_lyapunov(navigation, local.theta)
    else:
        reapproach = without_reapproach(memory.reapproach)
        lyapunov = global_lyapunov(navigation, config.gains)
    requested = _requested_command(switching.region, navigation, local, reapproach, config)
    command = _within_limits(requested, memory.command, dt, config)
    inside = reapproach.phase == RESTING and within(local, navigation.rho, command, config.tolerance, uncertainty)
    settling = next_settling(memory.settling, inside, config.tolerance)
    rho, alpha, beta = navigation
    report = Report(rho, alpha, beta, local.theta, radius, switching.region, lyapunov)
    return ControllerMemory(switching, command, settling, reapproach), command, report


def _next_switching(
    memory: ControllerMemory, rho: float, uncertainty: Uncertainty, config: ControllerConfig
) -> tuple[Switching, float]:
    policy = config.region_policy
    if not config.driving.allow_backward:
        narrow = forward_only(policy.covariance, config.tolerance.xy_goal_tolerance)
        policy = RegionPolicy(policy.kind, policy.fixed, narrow)
    return next_switching(memory.switching, rho, uncertainty.xy, policy, memory.reapproach.retreat_distance)


def _next_reapproach(
    memory: ControllerMemory, local: Pose, uncertainty: Uncertainty, dt: float, config: ControllerConfig
) -> Reapproach:
    """Return the next state of the re-approach; only the covariance policy has one, the paper's law stays as it is."""
    tolerance = config.tolerance
    if not (config.region_policy.kind == COVARIANCE and config.driving.allow_backward):
        # Also ends one that is under way when it is switched off.
        return without_reapproach(memory.reapproach)
    resting = (
        abs(memory.command.v) <= tolerance.trans_stopped_velocity
        and abs(memory.command.omega) <= tolerance.rot_stopped_velocity
        and abs(local.theta) <= tolerance.yaw_goal_tolerance
    )
    return next_reapproach(memory.reapproach, local, resting, uncertainty, dt, tolerance, config.reapproach)


def _requested_command(
    region: int, navigation: Navigation, local: Pose, reapproach: Reapproach, config: ControllerConfig
) -> Twist:
    """Return the command of the law or the re-approach, before the limits."""
    gains = config.gains
    if region != OMEGA_L:
        requested = global_law(navigation, gains)
    elif reapproach.phase == RESTING:
        requested = local_law(navigation, local.theta, gains)
    else:
        requested = reapproach_command(reapproach, local, gains.k_2, config.reapproach)
    if config.driving.allow_backward or requested.v >= 0.0:
        return requested
    # Stand where the law would reverse; in Omega_G turn towards the goal, which leaves dV = -k alpha^2 <= 0.
    return Twist(0.0, gains.k * navigation.alpha if region == OMEGA_G else requested.omega)


def _within_limits(requested: Twist, previous: Twist, dt: float, config: ControllerConfig) -> Twist:
    limited = limit_velocity(requested, config.limits, config.wheels)
    command = limit_acceleration(limited, previous, dt, config.limits)
    if not (math.isfinite(command.v) and math.isfinite(command.omega)):
        return Twist(0.0, 0.0)
    return command


def stop_step(memory: ControllerMemory, dt: float, config: ControllerConfig) -> tuple[ControllerMemory, Twist]:
    """One step of coming to rest without a goal: zero at once, or as the acceleration limits allow."""
    command = limit_acceleration(Twist(0.0, 0.0), memory.command, dt, config.limits)
    return memory._replace(command=command), command
