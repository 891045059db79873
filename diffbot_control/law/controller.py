"""The controller: one step as a pure function with its memory as argument and result."""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from diffbot_control.law.goal_checker import GoalTolerance, within
from diffbot_control.law.limits import Limits, limit_acceleration, limit_velocity
from diffbot_control.law.lyapunov_law import (
    Gains,
    global_law,
    global_lyapunov,
    local_law,
    local_lyapunov,
)
from diffbot_control.law.polar_coordinates import navigation_variables
from diffbot_control.law.reapproach import (
    RESTING,
    Reapproach,
    ReapproachConfig,
    next_reapproach,
    reapproach_command,
)
from diffbot_control.law.regions import (
    OMEGA_G,
    OMEGA_L,
    CovarianceRegion,
    FixedRegion,
    covariance_region,
    fixed_region,
    forward_only,
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
    """All that shapes the command; the defaults are the paper's controller, see presets.py for others."""

    gains: Gains = Gains()
    region: FixedRegion = FixedRegion()
    limits: Limits = Limits()
    wheels: WheelGeometry = WheelGeometry()
    tolerance: GoalTolerance = GoalTolerance()
    covariance_region: CovarianceRegion = CovarianceRegion()
    reapproach: ReapproachConfig = ReapproachConfig()
    driving: Driving = Driving()


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
    steps_outside: int = 0
    """poses in a row beyond the leaving radius (covariance policy)"""
    reapproach: Reapproach = Reapproach()


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


def new_memory() -> ControllerMemory:
    """Return the memory at rest with a new goal, every field spelt out: compiled code knows no defaults."""
    return ControllerMemory(OMEGA_G, 0.0, 0.0, 0, False, 0, 0, Reapproach(RESTING, 0, 0, 0.0, 0.0))


def memory_for_new_goal(memory: ControllerMemory) -> ControllerMemory:
    """Forget the old goal but not the motion: the acceleration limits hold across goals."""
    return ControllerMemory(v=memory.v, omega=memory.omega)


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
        goal: where to go.
        dt: [s] since the last step, for the acceleration limits; 0 lets no velocity change if those are set.
        config: gains, policy, limits, tolerances.
        uncertainty: of the estimate, for the region and for the goal; by default it is taken at its word.

    Returns:
        The next memory, the command, and what was seen. The command is zero if the numbers overflow.
    """
    local = into_frame(pose, goal)
    navigation = navigation_variables(local)
    if config.covariance_region.follow_covariance:
        policy = config.covariance_region
        if not config.driving.allow_backward:
            policy = forward_only(policy, config.tolerance.xy_goal_tolerance)
        retreat_distance = memory.reapproach.distance
        region, steps_outside, radius = covariance_region(
            memory.region, memory.steps_outside, navigation.rho, uncertainty.xy, policy, retreat_distance
        )
    else:
        region, steps_outside = fixed_region(memory.region, navigation.rho, config.region), 0
        radius = config.region.eps_P_leave if region == OMEGA_L else config.region.eps_P
    if region == OMEGA_L:
        reapproach = _reapproach(memory, local, uncertainty, dt, config)
        if reapproach.phase == RESTING:
            wanted = local_law(navigation, local.theta, config.gains)
        else:
            wanted = reapproach_command(reapproach, local, config.gains.k_2, config.reapproach)
        lyapunov = local_lyapunov(navigation, local.theta)
    else:
        reapproach = Reapproach(RESTING, memory.reapproach.tries, 0, memory.reapproach.time, 0.0)
        wanted = global_law(navigation, config.gains)
        lyapunov = global_lyapunov(navigation, config.gains)
    if not config.driving.allow_backward and wanted.v < 0.0:
        wanted = _forward_only(wanted, navigation.alpha, region, config.gains)
    limited = limit_velocity(wanted, config.limits, config.wheels)
    command = limit_acceleration(limited, Twist(memory.v, memory.omega), dt, config.limits)
    if not (math.isfinite(command.v) and math.isfinite(command.omega)):
        command = Twist(0.0, 0.0)
    inside = reapproach.phase == RESTING and within(local, navigation.rho, command, config.tolerance, uncertainty)
    steps_within = memory.steps_within + 1 if inside else 0
    reached = steps_within >= config.tolerance.settling_steps or (config.tolerance.stateful and memory.reached)
    switches = memory.switches + (1 if region != memory.region else 0)
    report = Report(navigation.rho, navigation.alpha, navigation.beta, local.theta, radius, region, lyapunov)
    return (
        ControllerMemory(region, command.v, command.omega, steps_within, reached, switches, steps_outside, reapproach),
        command,
        report,
    )


def _reapproach(
    memory: ControllerMemory, local: Pose, uncertainty: Uncertainty, dt: float, config: ControllerConfig
) -> Reapproach:
    """Return the next state of the re-approach; only the covariance policy has one, the paper's law stays as it is."""
    tolerance = config.tolerance
    if not (config.covariance_region.follow_covariance and config.driving.allow_backward):
        # Switched off while under way, it must not stay there.
        return Reapproach(RESTING, memory.reapproach.tries, 0, memory.reapproach.time, 0.0)
    resting = (
        abs(memory.v) <= tolerance.trans_stopped_velocity
        and abs(memory.omega) <= tolerance.rot_stopped_velocity
        and abs(local.theta) <= tolerance.yaw_goal_tolerance
    )
    return next_reapproach(memory.reapproach, local, resting, uncertainty, dt, tolerance, config.reapproach)


def _forward_only(wanted: Twist, alpha: float, region: int, gains: Gains) -> Twist:
    """Stand where the law would reverse; in Omega_G turn towards the goal, which leaves dV = -k alpha^2 <= 0."""
    return Twist(0.0, gains.k * alpha if region == OMEGA_G else wanted.omega)


def stop_step(memory: ControllerMemory, dt: float, config: ControllerConfig) -> tuple[ControllerMemory, Twist]:
    """One step of coming to rest without a goal: zero at once, or as the acceleration limits allow."""
    command = limit_acceleration(Twist(0.0, 0.0), Twist(memory.v, memory.omega), dt, config.limits)
    return memory._replace(v=command.v, omega=command.omega), command
