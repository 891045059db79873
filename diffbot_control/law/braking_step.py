"""One step of the law with braking profiles: latency, regions, course, limits and the finish put together."""

from __future__ import annotations

import math

from diffbot_control.law.configuration import AUTO, ControllerConfig, ControllerMemory, Report
from diffbot_control.law.finish import (
    LEAVING,
    Finish,
    Standing,
    finish_command,
    is_leg,
    next_finish,
    no_finish,
)
from diffbot_control.law.goal_checker import is_at_rest, next_settling, within
from diffbot_control.law.latency import Actuation, coast, is_immediate, predicted
from diffbot_control.law.limits import limit_change
from diffbot_control.law.lyapunov_law import local_lyapunov
from diffbot_control.law.polar_coordinates import HALF_PI, Navigation, navigation_variables
from diffbot_control.law.regions import (
    LEAVE_SIGMAS,
    OMEGA_G,
    OMEGA_L,
    RETREAT_MARGIN,
    Switching,
    next_switching,
)
from diffbot_control.law.speed_profile import ProfileGains, auto_gains, vagueness_of, within_data_sheet
from diffbot_control.law.steering import (
    BACK,
    UNDECIDED,
    Course,
    chosen_course,
    course_lyapunov,
    drive_and_hold,
    drive_and_steer,
    led_by,
    turn_to_the_goal,
)
from diffbot_core.geometry import Pose, into_frame, wrap_angle
from diffbot_core.kinematics import Twist
from diffbot_core.uncertainty import Estimate, Uncertainty


def braking_step(
    memory: ControllerMemory, estimate: Estimate, goal: Pose, dt: float, config: ControllerConfig
) -> tuple[ControllerMemory, Twist, Report]:
    """The law of steering.py for any goal pose; arguments and result are those of ``controller.step``."""
    actuation, estimate = coasted_estimate(memory, estimate, dt, config)
    uncertainty, tolerance = estimate.uncertainty, config.tolerance
    upright = into_frame(estimate.pose, goal)
    local = _turned(upright) if memory.course.turned else upright
    navigation = navigation_variables(local)
    switching, radius = _switching_after(memory, navigation.rho, uncertainty.xy, config)
    finish = no_finish()
    if switching.region == OMEGA_L:
        finish = _finish_after(memory, local, switching.steps_outside, uncertainty, dt, config)
        if finish.kind == LEAVING:
            switching, finish = Switching(OMEGA_G, switching.switches + 1, 0), no_finish()
    course = _course_after(memory, switching.region, upright, config)
    if course.turned != memory.course.turned:
        local = _turned(upright) if course.turned else upright
        navigation = navigation_variables(local)
    gains = gains_in_force(config, dt)
    vagueness = vagueness_of(uncertainty.xy, gains, tolerance.xy_goal_tolerance)
    if switching.region == OMEGA_L:
        lyapunov = local_lyapunov(navigation, local.theta)
        requested = _near(navigation, local, vagueness, finish, gains, config)
    else:
        led = led_by(navigation, course.leading)
        lyapunov = course_lyapunov(led, gains)
        requested = _far(led, vagueness, course.leading, gains, config)
    command = limit_change(requested, memory.command, dt, config.data_sheet)
    rho, alpha, beta = navigation
    if not math.isfinite(rho + alpha + local.theta + command.v + command.omega):
        command = Twist(0.0, 0.0)
    inside = switching.region == OMEGA_L and within(local, rho, command, tolerance, config.data_sheet, uncertainty)
    settling = next_settling(memory.settling, inside, tolerance)
    report = Report(rho, alpha, beta, local.theta, radius, switching.region, lyapunov)
    after = ControllerMemory(
        switching, command, settling, memory.reapproach, finish, course, actuation, settling.reached
    )
    return after, command, report


def coasted_estimate(
    memory: ControllerMemory, estimate: Estimate, dt: float, config: ControllerConfig
) -> tuple[Actuation, Estimate]:
    """Return what the law works with: the estimate of the pose in which a command acts at once (law/latency.py)."""
    if is_immediate(config.data_sheet):
        return memory.actuation, estimate
    coasted = coast(estimate.pose, memory.actuation, memory.command, dt, config.data_sheet)
    share = config.region_policy.covariance.eps_P_speed_error
    return coasted.actuation, predicted(coasted, estimate.uncertainty, share)


def gains_in_force(config: ControllerConfig, dt: float) -> ProfileGains:
    """Return the gains that the law uses: derived with ``gains: auto``, and within the limits of the data sheet."""
    if config.gain_source == AUTO:
        return auto_gains(config.data_sheet, dt)
    return within_data_sheet(config.profile_gains, config.data_sheet)


def _turned(local: Pose) -> Pose:
    """Return the pose in the frame of the goal turned round."""
    return Pose(-local.x, -local.y, wrap_angle(local.theta - math.pi))


def _switching_after(
    memory: ControllerMemory, rho: float, sigma_xy: float, config: ControllerConfig
) -> tuple[Switching, float]:
    # An error that is not beyond doubt outside the tolerance is worked off by the finish.
    beyond = config.tolerance.xy_goal_tolerance + LEAVE_SIGMAS * sigma_xy
    floor = max(beyond, RETREAT_MARGIN * memory.finish.reach)
    return next_switching(memory.switching, rho, sigma_xy, config.region_policy, floor)


def _course_after(memory: ControllerMemory, region: int, upright: Pose, config: ControllerConfig) -> Course:
    """Choose the course at a new goal, when Omega_L is left, and when the robot reverses and must not any more.

    ``upright`` is in the frame of the goal as given.
    """
    course, driving = memory.course, config.driving
    if region == OMEGA_G:
        is_allowed = driving.allow_backward or course.leading != BACK
        if course.leading != UNDECIDED and memory.switching.region == OMEGA_G and is_allowed:
            return course
        return chosen_course(navigation_variables(upright), driving.allow_backward, driving.symmetric_yaw_tolerance)
    if course.leading == UNDECIDED and not course.turned and driving.symmetric_yaw_tolerance:
        # The first pose with this goal is already near it: only the heading is left to choose.
        return Course(UNDECIDED, memory.command == (0.0, 0.0) and abs(upright.theta) > HALF_PI)
    return course


def _finish_after(
    memory: ControllerMemory,
    local: Pose,
    steps_outside: int,
    uncertainty: Uncertainty,
    dt: float,
    config: ControllerConfig,
) -> Finish:
    tolerance, rest = config.tolerance, 0.0
    # Beyond the leaving radius the robot does not rest: Omega_L is about to end.
    resting = steps_outside == 0 and is_at_rest(memory.command, tolerance, config.data_sheet)
    if resting and abs(local.theta) <= tolerance.yaw_goal_tolerance:
        rest = memory.finish.rest + dt
    standing = Standing(rest, memory.reached, config.driving.allow_backward)
    return next_finish(memory.finish, local, standing, uncertainty, tolerance, config.finish)


def _near(
    navigation: Navigation,
    local: Pose,
    vagueness: float,
    finish: Finish,
    gains: ProfileGains,
    config: ControllerConfig,
) -> Twist:
    """Return the command of Omega_L."""
    if is_leg(finish):
        return finish_command(finish, local, config.tolerance, config.finish, gains, config.data_sheet)
    command = drive_and_hold(navigation, local.theta, vagueness, gains, config.data_sheet)
    if config.driving.allow_backward or command.v >= 0.0:
        return command
    return Twist(0.0, command.omega)


def _far(led: Navigation, vagueness: float, leading: int, gains: ProfileGains, config: ControllerConfig) -> Twist:
    """Return the command of Omega_G; ``led`` is as of the end that leads."""
    if not config.driving.allow_backward and abs(led.alpha) >= HALF_PI:
        return turn_to_the_goal(led.alpha, gains, config.data_sheet)
    return drive_and_steer(led, vagueness, leading, gains, config.data_sheet)
