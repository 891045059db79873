"""Goal checker: when the robot rests, and when a goal counts as reached."""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from diffbot_core.data_sheet import DataSheet
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist
from diffbot_core.ranges import ANGLE, LENGTH, SPEED, TURN_RATE
from diffbot_core.schema import Spec, known_fields
from diffbot_core.uncertainty import CERTAIN, Uncertainty, disc_probability, interval_probability


@known_fields
class GoalTolerance(NamedTuple):
    """Tolerances with the names of Nav2's StoppedGoalChecker."""

    xy_goal_tolerance: Annotated[float, Spec("distance at which the position is reached", "m", *LENGTH)] = 0.1
    yaw_goal_tolerance: Annotated[float, Spec("heading error at which the heading is reached", "rad", *ANGLE)] = 0.1
    trans_stopped_velocity: Annotated[
        float,
        Spec("commanded |v| below which the robot counts as stopped", "m/s", *SPEED),
    ] = 0.05
    rot_stopped_velocity: Annotated[
        float,
        Spec("commanded |omega| below which the robot counts as stopped", "rad/s", *TURN_RATE),
    ] = 0.1
    settling_steps: Annotated[
        int,
        Spec("poses in a row that have to be within the tolerances", "-", minimum=1, maximum=100000),
    ] = 5
    reached_probability: Annotated[
        float,
        Spec(
            "probability, by the estimate's covariance, that the true pose is within the tolerances",
            "-",
            0.5,
            0.9999,
            replaces=("goal_sigmas",),
        ),
    ] = 0.99
    stateful: Annotated[bool, Spec("once reached, a goal stays reached until the next one")] = True


class Settling(NamedTuple):
    """Progress towards a reached goal; the default is that of a new goal."""

    steps_within: int = 0
    """poses in a row within the tolerances"""
    reached: bool = False


def next_settling(before: Settling, inside: bool, tolerance: GoalTolerance) -> Settling:
    """Count one more pose, ``inside`` the tolerances or not."""
    if not inside and before.steps_within == 0 and (tolerance.stateful or not before.reached):
        return before  # as in most steps: a new tuple costs time
    steps_within = before.steps_within + 1 if inside else 0
    reached = steps_within >= tolerance.settling_steps or (tolerance.stateful and before.reached)
    return Settling(steps_within, reached)


def is_at_rest(command: Twist, tolerance: GoalTolerance, data_sheet: DataSheet) -> bool:
    """Whether a command is one that the robot counts as stopped with; the smallest that moves it always is."""
    return abs(command.v) <= max(tolerance.trans_stopped_velocity, data_sheet.min_velocity) and abs(
        command.omega
    ) <= max(tolerance.rot_stopped_velocity, data_sheet.min_rotation)


def within(
    pose: Pose,
    rho: float,
    command: Twist,
    tolerance: GoalTolerance,
    data_sheet: DataSheet,
    uncertainty: Uncertainty = CERTAIN,
) -> bool:
    """Whether the robot rests, and its true pose is within the tolerances with ``reached_probability``.

    Errors of position and heading are taken for independent, and those of the position as large along both axes of the
    error ellipse as along its longer one.

    Args:
        pose: estimate, in the goal's frame.
        rho: [m] its distance from the goal.
        command: of this step.
        tolerance: of the goal.
        data_sheet: of the robot.
        uncertainty: of the estimate.
    """
    if rho > tolerance.xy_goal_tolerance or not is_at_rest(command, tolerance, data_sheet):
        return False
    return _probably_within(pose.theta, rho, tolerance, uncertainty)


def _probably_within(theta: float, rho: float, tolerance: GoalTolerance, uncertainty: Uncertainty) -> bool:
    required = tolerance.reached_probability
    heading = interval_probability(theta, uncertainty.theta, tolerance.yaw_goal_tolerance)
    if heading < required:
        return False
    return heading * disc_probability(rho, uncertainty.xy, tolerance.xy_goal_tolerance) >= required


def is_knowable(tolerance: GoalTolerance, uncertainty: Uncertainty) -> bool:
    """Whether an estimate of this uncertainty can be within the tolerances at all, with the goal as its mean."""
    return _probably_within(0.0, 0.0, tolerance, uncertainty)


def knowable_heading(tolerance: GoalTolerance, uncertainty: Uncertainty) -> bool:
    """Whether the heading is known well enough for the goal to be reached at all."""
    return interval_probability(0.0, uncertainty.theta, tolerance.yaw_goal_tolerance) >= tolerance.reached_probability


def smallest_tolerance(tolerance: GoalTolerance, uncertainty: Uncertainty) -> tuple[float, float]:
    """Return position [m] and heading [rad] tolerance, each alone, that an estimate of this uncertainty can meet.

    For the position the radius that P(distance <= r) = 1 - exp(-r^2 / (2 sigma^2)) gives; for the heading the bound of
    the normal distribution, by bisection.
    """
    rest = 1.0 - tolerance.reached_probability
    low, high = 0.0, 8.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        if interval_probability(0.0, 1.0, middle) < tolerance.reached_probability:
            low = middle
        else:
            high = middle
    return uncertainty.xy * math.sqrt(-2.0 * math.log(rest)), uncertainty.theta * high
