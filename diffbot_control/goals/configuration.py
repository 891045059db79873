"""Options of the controller beyond the law."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from diffbot_control.law.configuration import ControllerConfig
from diffbot_core.ranges import ANGLE, DISTANCE, TIME, TIMEOUT
from diffbot_core.schema import Spec, known_fields


@known_fields
class GoalUpdateConfig(NamedTuple):
    """Which corrections of the present goal are taken; a goal that is seen from ever nearer differs by less."""

    goal_update_distance: Annotated[
        float, Spec("a goal_update farther than this from the present goal is dropped", "m", *DISTANCE)
    ] = 0.5
    goal_update_angle: Annotated[
        float, Spec("a goal_update turned by more than this against the present goal is dropped", "rad", *ANGLE)
    ] = 0.5
    goal_update_timeout: Annotated[float, Spec("a goal_update with an older stamp is dropped", "s", *TIMEOUT)] = 1.0


@known_fields
class SupervisorConfig(NamedTuple):
    """Options of the controller beyond the law."""

    controller: ControllerConfig = ControllerConfig()
    pose_timeout: Annotated[float, Spec("the robot is stopped after this time without a pose", "s", *TIMEOUT)] = 0.5
    pose_lost_timeout: Annotated[
        float, Spec("the robot gives a goal up after this time without a pose; 0: never", "s", *TIME)
    ] = 30.0
    waypoint_radius: Annotated[
        float,
        Spec("distance at which a waypoint of a path is passed; 0: each is reached first", "m", *DISTANCE),
    ] = 0.4
    hold_goal: Annotated[bool, Spec("keep controlling at a reached goal; otherwise go idle")] = True
    hold_distance: Annotated[
        float,
        Spec(
            "a robot found farther from a held goal, and than twice xy_goal_tolerance, goes idle instead of back",
            "m",
            *DISTANCE,
        ),
    ] = 0.5
    goal_timeout: Annotated[
        float,
        Spec(
            "the robot gives a goal up that is not reached after this time; -1: derived from distance and limits;"
            " 0: never",
            "s",
            -1.0,
            TIME[1],
        ),
    ] = -1.0
    updates: GoalUpdateConfig = GoalUpdateConfig()
    max_departures: Annotated[
        int,
        Spec(
            "number of times that the robot leaves Omega_L (hunting) before it gives a goal up; 0: never",
            "-",
            0,
            100000,
        ),
    ] = 10
    publish_when_idle: Annotated[
        bool, Spec("answer every pose, with zero when there is no goal (lock-step needs it)")
    ] = False
