"""Goal checker: when a goal counts as reached."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist
from diffbot_core.ranges import ANGLE, LENGTH, SIGMAS, SPEED, TURN_RATE
from diffbot_core.schema import Spec
from diffbot_core.uncertainty import CERTAIN, Uncertainty


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
    goal_sigmas: Annotated[float, Spec("standard deviations of the estimate added to its errors", "-", *SIGMAS)] = 3.8
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


def within(
    pose: Pose, rho: float, command: Twist, tolerance: GoalTolerance, uncertainty: Uncertainty = CERTAIN
) -> bool:
    """Whether the robot rests inside the tolerances, with a margin for the uncertainty of its pose.

    Args:
        pose: estimate, in the goal's frame.
        rho: [m] its distance from the goal.
        command: of this step.
        tolerance: of the goal.
        uncertainty: of the estimate; ``goal_sigmas`` of it are added to the errors.
    """
    return (
        rho + tolerance.goal_sigmas * uncertainty.xy <= tolerance.xy_goal_tolerance
        and abs(pose.theta) + tolerance.goal_sigmas * uncertainty.theta <= tolerance.yaw_goal_tolerance
        and abs(command.v) <= tolerance.trans_stopped_velocity
        and abs(command.omega) <= tolerance.rot_stopped_velocity
    )


def is_knowable(tolerance: GoalTolerance, uncertainty: Uncertainty) -> bool:
    """Whether an estimate of this uncertainty can be inside the tolerances at all."""
    return (
        tolerance.goal_sigmas * uncertainty.xy < tolerance.xy_goal_tolerance
        and tolerance.goal_sigmas * uncertainty.theta < tolerance.yaw_goal_tolerance
    )
