"""The law ``switching``: its step predicts over the latency, selects region and approach, and limits the command."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from diffbot_control.law.configuration import SwitchingConfig
from diffbot_control.law.goal_checker import Settling, next_settling, within
from diffbot_control.law.latency import Actuation, after_a_period, coast, is_immediate, predicted, resting_actuation
from diffbot_control.law.law import Law, Observation, Report
from diffbot_control.law.limits import limit_change
from diffbot_control.law.regions import MAX_DEPARTURES, OMEGA_G, OMEGA_L, Switching, SwitchInput, next_switching
from diffbot_control.law.steering import (
    BACKWARD,
    HALF_PI,
    UNDECIDED,
    Approach,
    Gains,
    Navigation,
    choose_approach,
    drive_and_hold,
    drive_and_steer,
    gains_of,
    global_lyapunov,
    in_direction,
    local_lyapunov,
    navigation_variables,
    turn_to_the_goal,
    uncertainty_ratio,
)
from diffbot_core.geometry import Pose, into_frame, wrap_angle
from diffbot_core.kinematics import Twist
from diffbot_core.uncertainty import Estimate


class SwitchingMemory(NamedTuple):
    """State of the law between two steps."""

    switching: Switching
    command: Twist
    """the last command"""
    settling: Settling
    approach: Approach
    actuation: Actuation
    reached: bool
    """the goal counts as reached"""


def new_memory() -> SwitchingMemory:
    """Return the memory at rest with a new goal."""
    return SwitchingMemory(
        Switching(OMEGA_G, 0, 0.0),
        Twist(0.0, 0.0),
        Settling(0, False),
        Approach(UNDECIDED, False),
        resting_actuation(),
        False,
    )


def with_motion(memory: SwitchingMemory, command: Twist, actuation: Actuation) -> SwitchingMemory:
    """Return the memory with another motion, in a form that numba can compile."""
    return SwitchingMemory(memory.switching, command, memory.settling, memory.approach, actuation, memory.reached)


def step(
    memory: SwitchingMemory, observation: Observation, goal: Pose, config: SwitchingConfig
) -> tuple[SwitchingMemory, Twist, Report]:
    """Drive towards ``goal`` for one period, within the limits; see :meth:`Law.step`.

    If a variable is not finite, the command is zero.
    """
    dt, sheet, tolerance = observation.dt, config.data_sheet, config.tolerance
    actuation, estimate = coasted_estimate(memory, observation.estimate, dt, config)
    uncertainty = estimate.uncertainty
    original = into_frame(estimate.pose, goal)
    local = _turned(original) if memory.approach.opposite_heading else original
    navigation = navigation_variables(local)
    present = SwitchInput(navigation.rho, local.theta, memory.command, memory.reached)
    switching, radius = next_switching(memory.switching, present, uncertainty, dt, tolerance, sheet)
    approach = _next_approach(memory, switching.region, original, config)
    if approach.opposite_heading != memory.approach.opposite_heading:
        local = _turned(original) if approach.opposite_heading else original
        navigation = navigation_variables(local)
    gains = gains_of(sheet, observation.period)
    ratio = uncertainty_ratio(uncertainty.xy, config.sigma_known, tolerance.xy_goal_tolerance)
    if switching.region == OMEGA_L:
        lyapunov = local_lyapunov(navigation, local.theta)
        requested = _near(navigation, local.theta, ratio, gains, config)
    else:
        directed = in_direction(navigation, approach.direction)
        lyapunov = global_lyapunov(directed)
        requested = _far(directed, ratio, approach.direction, gains, config)
    command = limit_change(requested, memory.command, dt, sheet)
    rho, alpha, beta = navigation
    if not math.isfinite(rho + alpha + local.theta + command.v + command.omega):
        command = Twist(0.0, 0.0)
    inside = switching.region == OMEGA_L and within(local, rho, command, tolerance, sheet, uncertainty)
    settling = next_settling(memory.settling, inside, tolerance)
    report = Report(rho, alpha, beta, local.theta, radius, switching.region, lyapunov)
    after = SwitchingMemory(switching, command, settling, approach, actuation, settling.reached)
    return after, command, report


def coasted_estimate(
    memory: SwitchingMemory, estimate: Estimate, dt: float, config: SwitchingConfig
) -> tuple[Actuation, Estimate]:
    """Return the actuation, and the estimate of the pose in which the robot would come to rest; see :mod:`latency`."""
    if is_immediate(config.data_sheet):
        return memory.actuation, estimate
    coasted = coast(estimate.pose, memory.actuation, memory.command, dt, config.data_sheet)
    return coasted.actuation, predicted(coasted, estimate.uncertainty)


def _turned(local: Pose) -> Pose:
    """Transform a pose from the frame of the goal to the frame of the goal turned by pi."""
    return Pose(-local.x, -local.y, wrap_angle(local.theta - math.pi))


def _next_approach(memory: SwitchingMemory, region: int, pose: Pose, config: SwitchingConfig) -> Approach:
    """Return the approach; choose a new one for a new goal, after Omega_L, and if the approach is no longer allowed.

    ``pose`` is in the frame of the goal, not in the frame turned by pi.
    """
    approach = memory.approach
    if region == OMEGA_G:
        is_allowed = config.allow_backward or approach.direction != BACKWARD
        if approach.direction != UNDECIDED and memory.switching.region == OMEGA_G and is_allowed:
            return approach
        return choose_approach(navigation_variables(pose), config.allow_backward, config.symmetric_yaw_tolerance)
    if approach.direction == UNDECIDED and not approach.opposite_heading and config.symmetric_yaw_tolerance:
        # The first pose is already near the goal, so the law chooses only the heading.
        return Approach(UNDECIDED, memory.command == (0.0, 0.0) and abs(pose.theta) > HALF_PI)
    return approach


def _near(navigation: Navigation, theta: float, ratio: float, gains: Gains, config: SwitchingConfig) -> Twist:
    """Return the command of Omega_L."""
    command = drive_and_hold(navigation, theta, ratio, gains, config.data_sheet)
    if config.allow_backward or command.v >= 0.0:
        return command
    return Twist(0.0, command.omega)


def _far(directed: Navigation, ratio: float, direction: int, gains: Gains, config: SwitchingConfig) -> Twist:
    """Return the command of Omega_G; ``directed`` is the result of :func:`in_direction`."""
    if not config.allow_backward and abs(directed.alpha) >= HALF_PI:
        return turn_to_the_goal(directed.alpha, gains, config.data_sheet)
    return drive_and_steer(directed, ratio, direction, gains, config.data_sheet)


class SwitchingLaw(Law):
    """The law of this project."""

    name = "switching"
    Config = SwitchingConfig
    step = staticmethod(step)

    @staticmethod
    def new_memory(config: Any) -> SwitchingMemory:
        """Return the memory at rest with a new goal."""
        return new_memory()

    @classmethod
    def memory_for_new_goal(cls, memory: Any, config: Any) -> SwitchingMemory:
        """Return a new memory with the current motion, for the limits of acceleration and the prediction."""
        return with_motion(new_memory(), memory.command, memory.actuation)

    @staticmethod
    def after_command(memory: Any, command: Twist, dt: float, config: Any) -> SwitchingMemory:
        """Store the new command and the motion, and restart the count of consecutive poses within the tolerances."""
        actuation = after_a_period(memory.actuation, memory.command, dt, config.data_sheet)
        after: SwitchingMemory = memory._replace(command=command, actuation=actuation)
        return after._replace(settling=after.settling._replace(steps_within=0))

    @staticmethod
    def reason_to_give_up(memory: Any, config: Any) -> str:
        """Return why the robot gives up, if it has left Omega_L too often."""
        departures = memory.switching.switches // 2
        if departures < MAX_DEPARTURES:
            return ""
        return f"the robot left the neighbourhood of the goal {departures} times, because the estimate keeps changing"
