"""What users give: poses, robots and parameters, checked and in the types of the rooms below."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from os import PathLike
from typing import Any, TypeAlias

from diffbot_core.errors import InvalidValueError, known_name
from diffbot_core.geometry import MAX_COORDINATE, Pose
from diffbot_core.schema import C, build, parameters_of
from diffbot_core.uncertainty import Uncertainty
from diffbot_tools.arguments import MAX_SEED, checked_heading
from diffbot_tools.robot import RobotConfig, read_robot
from diffbot_tools.robot_description import PRESETS, RobotDescription

AnyPose: TypeAlias = Pose | Sequence[float]
"""x [m], y [m], heading [rad]"""
AnyRobot: TypeAlias = str | PathLike[str] | RobotDescription | RobotConfig
"""A parameter file, the name of one of ROBOTS, a description, or a robot."""


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


def goal_of(name: str, value: AnyPose) -> Pose:
    """Return a pose that the user has chosen, whose heading is therefore within a turn; see :func:`pose_of`."""
    pose = pose_of(name, value)
    checked_heading(name, pose.theta)
    return pose


def sigma_of(value: Sequence[float], minimum: float = 0.0) -> Uncertainty:
    """Return two standard deviations.

    Raises:
        InvalidValueError: if they are not two finite numbers, at least ``minimum``.
    """
    try:
        first, second = (float(number) for number in value)
    except (TypeError, ValueError):
        raise InvalidValueError("sigma", value, "two numbers") from None
    if not minimum <= min(first, second) <= max(first, second) < math.inf:
        raise InvalidValueError("sigma", value, f"two finite numbers >= {minimum:g}")
    return Uncertainty(first, second)


def time_of(value: float, after: float = -math.inf) -> float:
    """Return a time [s].

    Raises:
        InvalidValueError: if it is not a finite number, or not later than ``after``.
    """
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise InvalidValueError("time", value, "a finite number [s]")
    if value <= after:
        raise InvalidValueError("time", value, f"> {after:g}, the time before")
    return float(value)


def seed_of(value: int) -> int:
    """Return a seed.

    Raises:
        InvalidValueError: if it is not a whole number from 0 to 2^63 - 1.
    """
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= MAX_SEED:
        raise InvalidValueError("seed", value, "a whole number >= 0")
    return value


def robot_of(value: AnyRobot) -> RobotConfig:
    """Return a robot, whatever describes it.

    Raises:
        DiffbotError: in one line, if nothing does, or a value is not allowed.
    """
    if isinstance(value, RobotConfig):
        return value
    if not isinstance(value, (str, PathLike, RobotDescription)):
        raise InvalidValueError("robot", value, "a parameter file, the name of one of ROBOTS, or diffbot.robot(...)")
    return read_robot(value)


def robot(like: str = "turtlebot3_burger", **values: Any) -> RobotConfig:
    """Return a robot that differs from one of ROBOTS in some values.

    Examples:
        >>> import diffbot
        >>> slow = diffbot.robot("turtlebot4", linear_x_max_velocity=0.1)
        >>> slow
        <Robot turtlebot4: 0.1 m/s, 1.9 rad/s, latency 0.12 s, tolerances 0.15 m and 0.15 rad>
        >>> diffbot.drive((0.5, 0.0, 0.0), robot=slow).duration > 5.0
        True

    Args:
        like: the name of that one.
        values: fields of a description, by the names of the parameters with ``_`` for the dots, as the flags of
            ``diffbot robot new``.

    Raises:
        InvalidValueError: for a value that is not allowed, or an unknown name, with those like it.
    """
    if like not in PRESETS:
        raise InvalidValueError("like", like, known_name(like, PRESETS))
    return read_robot(with_parameters(PRESETS[like], values))._replace(name=like)


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
