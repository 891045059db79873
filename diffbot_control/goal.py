"""When a goal counts as reached."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from diffbot_control.config import Spec
from diffbot_control.geometry import Pose
from diffbot_control.kinematics import Twist


class GoalTolerance(NamedTuple):
    """Tolerances with the names of Nav2's StoppedGoalChecker.

    The position tolerance is wide because the paper's law with a fixed region leaves a lateral error of some 0.2 m.
    """

    xy_goal_tolerance: Annotated[
        float, Spec("distance at which the position is reached", "m", minimum=0.0, above=True)
    ] = 0.4
    yaw_goal_tolerance: Annotated[
        float, Spec("heading error at which the heading is reached", "rad", minimum=0.0, above=True)
    ] = 0.1
    trans_stopped_velocity: Annotated[
        float,
        Spec("commanded |v| below which the robot counts as stopped", "m/s", minimum=0.0, above=True),
    ] = 0.05
    rot_stopped_velocity: Annotated[
        float,
        Spec("commanded |omega| below which it counts as stopped", "rad/s", minimum=0.0, above=True),
    ] = 0.1
    settling_steps: Annotated[
        int,
        Spec("poses in a row that have to be within the tolerances", "-", minimum=1, maximum=100000),
    ] = 5
    stateful: Annotated[bool, Spec("once reached, a goal stays reached until the next one")] = True


def within(pose: Pose, rho: float, command: Twist, tolerance: GoalTolerance) -> bool:
    """Whether pose and command are inside the tolerances; ``pose`` is in the goal's frame, ``rho`` [m] its distance."""
    return (
        rho <= tolerance.xy_goal_tolerance
        and abs(pose.theta) <= tolerance.yaw_goal_tolerance
        and abs(command.v) <= tolerance.trans_stopped_velocity
        and abs(command.omega) <= tolerance.rot_stopped_velocity
    )
