"""When a goal counts as reached."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist
from diffbot_core.schema import Spec
from diffbot_core.uncertainty import CERTAIN, Uncertainty


class GoalTolerance(NamedTuple):
    """Tolerances with the names of Nav2's StoppedGoalChecker.

    The position tolerance is wide because the paper's law with a fixed region leaves a lateral error of some 0.2 m.
    """

    xy_goal_tolerance: Annotated[
        float, Spec("distance at which the position is reached", "m", minimum=0.0, exclusive_minimum=True)
    ] = 0.4
    yaw_goal_tolerance: Annotated[
        float, Spec("heading error at which the heading is reached", "rad", minimum=0.0, exclusive_minimum=True)
    ] = 0.1
    trans_stopped_velocity: Annotated[
        float,
        Spec("commanded |v| below which the robot counts as stopped", "m/s", minimum=0.0, exclusive_minimum=True),
    ] = 0.05
    rot_stopped_velocity: Annotated[
        float,
        Spec("commanded |omega| below which it counts as stopped", "rad/s", minimum=0.0, exclusive_minimum=True),
    ] = 0.1
    settling_steps: Annotated[
        int,
        Spec("poses in a row that have to be within the tolerances", "-", minimum=1, maximum=100000),
    ] = 5
    goal_sigmas: Annotated[
        float, Spec("standard deviations of the estimate that have to fit into the tolerances, too", minimum=0.0)
    ] = 2.0
    stateful: Annotated[bool, Spec("once reached, a goal stays reached until the next one")] = True


def within(
    pose: Pose, rho: float, command: Twist, tolerance: GoalTolerance, uncertainty: Uncertainty = CERTAIN
) -> bool:
    """Whether the robot rests inside the tolerances for certain.

    Args:
        pose: estimate, in the goal's frame.
        rho: [m] its distance from the goal.
        command: what is being sent.
        tolerance: what is asked for.
        uncertainty: of the estimate; ``goal_sigmas`` of it are added to the errors.
    """
    return (
        rho + tolerance.goal_sigmas * uncertainty.xy <= tolerance.xy_goal_tolerance
        and abs(pose.theta) + tolerance.goal_sigmas * uncertainty.theta <= tolerance.yaw_goal_tolerance
        and abs(command.v) <= tolerance.trans_stopped_velocity
        and abs(command.omega) <= tolerance.rot_stopped_velocity
    )


def is_knowable(tolerance: GoalTolerance, uncertainty: Uncertainty) -> bool:
    """Whether an estimate that uncertain could be inside the tolerances at all."""
    return (
        tolerance.goal_sigmas * uncertainty.xy < tolerance.xy_goal_tolerance
        and tolerance.goal_sigmas * uncertainty.theta < tolerance.yaw_goal_tolerance
    )
