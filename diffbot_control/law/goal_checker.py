"""Goal checker: decides whether the robot is at rest, and whether it has reached its goal."""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from diffbot_core.data_sheet import DataSheet
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist
from diffbot_core.schema import ANGLE, LENGTH, Spec, known_fields
from diffbot_core.uncertainty import CERTAIN, Uncertainty, disc_probability, interval_probability

STOPPED_SPEED, STOPPED_TURN_RATE = 0.05, 0.1
"""[m/s], [rad/s] largest commands that count as rest"""
_SOON = 3.0
"""A robot at rest will soon count as at the goal if its probability of being outside the tolerance is at most this
multiple of the allowed probability, because the estimate still improves."""


@known_fields
class GoalTolerance(NamedTuple):
    """Tolerances with the names of Nav2's StoppedGoalChecker."""

    xy_goal_tolerance: Annotated[float, Spec("distance at which the position is reached", "m", *LENGTH)] = 0.1
    yaw_goal_tolerance: Annotated[float, Spec("heading error at which the heading is reached", "rad", *ANGLE)] = 0.1
    settling_steps: Annotated[
        int,
        Spec("number of consecutive poses that must be within the tolerances", "-", minimum=1, maximum=100000),
    ] = 5
    reached_probability: Annotated[
        float,
        Spec(
            "required probability, given the covariance of the pose, that the true pose is within the tolerances",
            "-",
            0.5,
            0.9999,
        ),
    ] = 0.99


class Settling(NamedTuple):
    """Progress towards a reached goal."""

    steps_within: int
    """number of consecutive poses within the tolerances"""
    reached: bool
    """True from the time at which the goal was reached until the next goal"""


def next_settling(before: Settling, inside: bool, tolerance: GoalTolerance) -> Settling:
    """Return the progress after one more pose; ``inside`` is True if the pose is within the tolerances."""
    if not inside and before.steps_within == 0:
        return before  # the usual case: faster than a new tuple
    steps_within = before.steps_within + 1 if inside else 0
    return Settling(steps_within, before.reached or steps_within >= tolerance.settling_steps)


def is_at_rest(command: Twist, data_sheet: DataSheet) -> bool:
    """Return True if the command is below the stopped thresholds, which are at least the dead band."""
    return abs(command.v) <= max(STOPPED_SPEED, data_sheet.min_velocity) and abs(command.omega) <= max(
        STOPPED_TURN_RATE, data_sheet.min_rotation
    )


def within(
    pose: Pose,
    rho: float,
    command: Twist,
    tolerance: GoalTolerance,
    data_sheet: DataSheet,
    uncertainty: Uncertainty = CERTAIN,
) -> bool:
    """Return True if the robot rests, and its true pose is within the tolerances with ``reached_probability``.

    The errors of position and heading are assumed independent. The standard deviation along the longer axis of the
    position's error ellipse is used for both axes.

    Args:
        pose: estimate, in the goal's frame.
        rho: [m] distance from the goal.
        command: command of this step.
        tolerance: tolerances of the goal.
        data_sheet: thresholds of rest.
        uncertainty: uncertainty of the estimate.
    """
    if rho > tolerance.xy_goal_tolerance or not is_at_rest(command, data_sheet):
        return False
    return _probably_within(pose.theta, rho, tolerance, uncertainty)


def _probably_within(theta: float, rho: float, tolerance: GoalTolerance, uncertainty: Uncertainty) -> bool:
    required = tolerance.reached_probability
    heading = interval_probability(theta, uncertainty.theta, tolerance.yaw_goal_tolerance)
    if heading < required:
        return False
    return heading * disc_probability(rho, uncertainty.xy, tolerance.xy_goal_tolerance) >= required


def is_knowable(tolerance: GoalTolerance, uncertainty: Uncertainty) -> bool:
    """Return True if an estimate with this uncertainty counts as reached when its mean is at the goal."""
    return _probably_within(0.0, 0.0, tolerance, uncertainty)


def is_off(rho: float, tolerance: GoalTolerance, uncertainty: Uncertainty) -> bool:
    """Return True if the position error ``rho`` [m] is significant.

    That is, a robot that rests here will not soon count as at the goal, but a robot at the goal point would.
    """
    radius, missing = tolerance.xy_goal_tolerance, 1.0 - tolerance.reached_probability
    if disc_probability(rho, uncertainty.xy, radius) >= 1.0 - _SOON * missing:
        return False
    return disc_probability(0.0, uncertainty.xy, radius) >= 1.0 - missing


def smallest_tolerance(tolerance: GoalTolerance, uncertainty: Uncertainty) -> tuple[float, float]:
    """Return the smallest tolerances of position [m] and heading [rad], each considered alone, for this uncertainty.

    The radius follows from P(distance <= r) = 1 - exp(-r^2 / (2 sigma^2)). The angle follows from the normal
    distribution, by bisection.
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
