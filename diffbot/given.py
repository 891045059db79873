"""What users give: poses, robots and parameters, checked and in the types of the rooms below."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from os import PathLike
from typing import Any, TypeAlias

from diffbot_core.errors import InvalidValueError, known_name
from diffbot_core.geometry import MAX_COORDINATE, Pose
from diffbot_core.schema import C, build, parameters_of
from diffbot_tools.robot.description import PRESETS, RobotDescription
from diffbot_tools.robot.robot import Robot, read_robot

AnyPose: TypeAlias = Pose | Sequence[float]
"""x [m], y [m], heading [rad]"""
AnyRobot: TypeAlias = str | PathLike[str] | RobotDescription | Robot
"""A parameter file, the name of one of ROBOTS, a description."""


def pose_of(name: str, value: AnyPose) -> Pose:
    """Return three numbers as a pose.

    Raises:
        InvalidValueError: naming ``name`` if they are not three finite numbers, or too large.
    """
    try:
        x, y, theta = (float(number) for number in value)
    except (TypeError, ValueError):
        raise InvalidValueError(name, value, "x, y and heading: three numbers") from None
    if not (abs(x) <= MAX_COORDINATE and abs(y) <= MAX_COORDINATE and math.isfinite(theta)):
        raise InvalidValueError(name, value, f"finite, and within +-{MAX_COORDINATE:g} m")
    return Pose(x, y, theta)


def robot_of(value: AnyRobot) -> Robot:
    """Return a robot, whatever describes it.

    Raises:
        DiffbotError: in one line, if nothing does, or a value is not allowed.
    """
    return value if isinstance(value, Robot) else read_robot(value)


def robot(like: str = "turtlebot3_burger", **values: Any) -> Robot:
    """Return a robot that differs from one of ROBOTS in some values.

    Examples:
        >>> import diffbot
        >>> slow = diffbot.robot("turtlebot4", max_velocity=0.1)
        >>> diffbot.drive((0.5, 0.0, 0.0), robot=slow).duration > 5.0
        True

    Args:
        like: the name of that one.
        values: fields of a description, as the flags of ``diffbot robot new``.

    Raises:
        InvalidValueError: for a value that is not allowed, or an unknown name, with those like it.
    """
    if like not in PRESETS:
        raise InvalidValueError("like", like, known_name(like, PRESETS))
    return read_robot(build(RobotDescription, values, PRESETS[like]))


def with_parameters(config: C, values: Mapping[str, Any]) -> C:
    """Return a configuration with parameters set; their names have ``_`` for the dots of ROS.

    Raises:
        InvalidValueError: for a value that is not allowed, or an unknown name, with those like it.
    """
    names = {one.name.replace(".", "_"): one.name for one in parameters_of(type(config))}
    for name, value in values.items():
        if name not in names:
            raise InvalidValueError(name, value, known_name(name, names))
    return build(type(config), {names[name]: value for name, value in values.items()}, config)
