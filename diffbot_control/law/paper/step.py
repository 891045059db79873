"""One step of the paper's law: (17) with its tanh profile, limits that keep the curvature, and the re-approach."""

from __future__ import annotations

import math

from diffbot_control.law.configuration import ControllerConfig, ControllerMemory, Report
from diffbot_control.law.goal_checker import is_at_rest, next_settling, within
from diffbot_control.law.limits import limit_acceleration, limit_velocity
from diffbot_control.law.lyapunov_law import global_law, global_lyapunov, local_law, local_lyapunov
from diffbot_control.law.paper.reapproach import (
    RESTING,
    Reapproach,
    next_reapproach,
    reapproach_command,
    without_reapproach,
)
from diffbot_control.law.polar_coordinates import Navigation, navigation_variables
from diffbot_control.law.regions import (
    COVARIANCE,
    OMEGA_G,
    OMEGA_L,
    RETREAT_MARGIN,
    CovarianceRegionPolicy,
    RegionPolicy,
    Switching,
    next_switching,
)
from diffbot_core.geometry import Pose, into_frame
from diffbot_core.kinematics import Twist
from diffbot_core.uncertainty import Estimate, Uncertainty


def paper_step(
    memory: ControllerMemory, estimate: Estimate, goal: Pose, dt: float, config: ControllerConfig
) -> tuple[ControllerMemory, Twist, Report]:
    """Law (17) for any goal pose, within the limits; arguments and result are those of ``controller.step``."""
    uncertainty = estimate.uncertainty
    local = into_frame(estimate.pose, goal)
    navigation = navigation_variables(local)
    switching, radius = _region_after(memory, navigation.rho, uncertainty, config)
    if switching.region == OMEGA_L:
        reapproach = _reapproach_after(memory, local, uncertainty, dt, config)
        lyapunov = local_lyapunov(navigation, local.theta)
    else:
        reapproach = without_reapproach(memory.reapproach)
        lyapunov = global_lyapunov(navigation, config.gains)
    requested = _requested_command(switching.region, navigation, local, reapproach, config)
    command = _within_limits(requested, memory.command, dt, config)
    inside = reapproach.phase == RESTING and within(
        local, navigation.rho, command, config.tolerance, config.data_sheet, uncertainty
    )
    settling = next_settling(memory.settling, inside, config.tolerance)
    rho, alpha, beta = navigation
    report = Report(rho, alpha, beta, local.theta, radius, switching.region, lyapunov)
    finish, course, actuation = memory.finish, memory.course, memory.actuation
    after = ControllerMemory(switching, command, settling, reapproach, finish, course, actuation, settling.reached)
    return after, command, report


def _region_after(
    memory: ControllerMemory, rho: float, uncertainty: Uncertainty, config: ControllerConfig
) -> tuple[Switching, float]:
    policy, tolerance = config.region_policy, config.tolerance.xy_goal_tolerance
    if not config.driving.allow_backward:
        policy = RegionPolicy(policy.kind, policy.fixed, _forward_only(policy.covariance, tolerance))
    floor = max(tolerance, RETREAT_MARGIN * memory.reapproach.retreat_distance)
    return next_switching(memory.switching, rho, uncertainty.xy, policy, floor)


def _forward_only(policy: CovarianceRegionPolicy, xy_goal_tolerance: float) -> CovarianceRegionPolicy:
    """Return the policy for a robot that may not reverse, and so cannot re-approach.

    It has to leave Omega_L with any error beyond the tolerance [m]: standing there, it could not correct it.
    """
    return CovarianceRegionPolicy(
        eps_P_min=policy.eps_P_min,
        eps_P_sigmas=policy.eps_P_sigmas,
        eps_P_speed_error=policy.eps_P_speed_error,
        eps_P_leave_factor=policy.eps_P_leave_factor,
        eps_P_leave_min=min(policy.eps_P_leave_min, xy_goal_tolerance),
        eps_P_leave_steps=policy.eps_P_leave_steps,
    )


def _reapproach_after(
    memory: ControllerMemory, local: Pose, uncertainty: Uncertainty, dt: float, config: ControllerConfig
) -> Reapproach:
    """Return the next state of the re-approach; only the covariance policy has one, the paper's law stays as it is."""
    tolerance = config.tolerance
    if not (config.region_policy.kind == COVARIANCE and config.driving.allow_backward):
        # Also ends one that is under way when it is switched off.
        return without_reapproach(memory.reapproach)
    resting = (
        is_at_rest(memory.command, tolerance, config.data_sheet) and abs(local.theta) <= tolerance.yaw_goal_tolerance
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
        requested = reapproach_command(reapproach, local, gains.k_2)
    if config.driving.allow_backward or requested.v >= 0.0:
        return requested
    # Stand where the law would reverse; in Omega_G turn towards the goal, which leaves dV = -k alpha^2 <= 0.
    return Twist(0.0, gains.k * navigation.alpha if region == OMEGA_G else requested.omega)


def _within_limits(requested: Twist, previous: Twist, dt: float, config: ControllerConfig) -> Twist:
    limited = limit_velocity(requested, config.data_sheet)
    command = limit_acceleration(limited, previous, dt, config.data_sheet)
    if not (math.isfinite(command.v) and math.isfinite(command.omega)):
        return Twist(0.0, 0.0)
    return command
