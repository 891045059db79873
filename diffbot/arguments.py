"""Check the arguments of the Python interface, and convert them to the types of the other packages."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from numbers import Integral, Real
from os import PathLike
from typing import Any, TypeAlias

from diffbot_core.errors import InvalidValueError, known_name
from diffbot_core.geometry import MAX_COORDINATE, Pose
from diffbot_core.schema import C, build, parameters_of
from diffbot_core.uncertainty import Uncertainty
from diffbot_tools.arguments import MAX_SEED, checked_heading
from diffbot_tools.robot import RobotConfig, read_robot
from diffbot_tools.robot_description import PRESETS, RobotDescription

MAX_TIME = 9e9
"""[s] largest time, since a stamp is a number of nanoseconds in 64 bits"""
AnyPose: TypeAlias = Pose | Sequence[float]
"""x [m], y [m] and heading [rad]."""
AnyRobot: TypeAlias = str | PathLike[str] | RobotDescription | RobotConfig
"""A parameter file, a name in ROBOTS, a description, or the result of :func:`robot`."""


def pose_of(name: str, value: AnyPose) -> Pose:
    """Convert the argument ``name`` to a pose.

    Raises:
        InvalidValueError: if it is not three finite numbers, or a coordinate is too large.
    """
    try:
        x, y, theta = (float(number) for number in value)
    except (TypeError, ValueError):
        raise InvalidValueError(name, value, "three numbers: x [m], y [m] and heading [rad]") from None
    if not (abs(x) <= MAX_COORDINATE and abs(y) <= MAX_COORDINATE and math.isfinite(theta)):
        raise InvalidValueError(name, value, f"three finite numbers, with x and y within +-{MAX_COORDINATE:g} m")
    return Pose(x, y, theta)


def goal_of(name: str, value: AnyPose) -> Pose:
    """Convert an argument as :func:`pose_of` does, and refuse a heading that seems to be in degrees.

    Raises:
        InvalidValueError: if the value is not allowed.
    """
    pose = pose_of(name, value)
    checked_heading(name, pose.theta)
    return pose


def sigma_of(value: Sequence[float], minimum: float = 0.0) -> Uncertainty:
    """Convert the argument ``sigma`` to standard deviations [m], [rad].

    Raises:
        InvalidValueError: if it is not two finite numbers >= ``minimum``.
    """
    try:
        first, second = (float(number) for number in value)
    except (TypeError, ValueError):
        raise InvalidValueError("sigma", value, "two numbers") from None
    if not minimum <= min(first, second) <= max(first, second) < math.inf:
        raise InvalidValueError("sigma", value, f"two finite numbers >= {minimum:g}")
    return Uncertainty(first, second)


def number_of(name: str, value: float, limit: float, unit: str) -> float:
    """Check that an argument is a number within +- ``limit``; numbers of numpy are allowed.

    Raises:
        InvalidValueError: if it is not.
    """
    if isinstance(value, bool) or not isinstance(value, Real) or not abs(value) <= limit:
        raise InvalidValueError(name, value, f"a finite number [{unit}] within +-{limit:g}")
    return float(value)


def time_of(value: float, previous: float = -math.inf) -> float:
    """Check the argument ``time`` [s].

    Raises:
        InvalidValueError: if it is not a finite number > ``previous``.
    """
    time = number_of("time", value, MAX_TIME, "s")
    if time <= previous:
        raise InvalidValueError("time", value, f"> {previous:g}, the previous time")
    return time


def seed_of(value: int) -> int:
    """Check the argument ``seed``.

    Raises:
        InvalidValueError: if it is not an integer from 0 to 2^63 - 1.
    """
    if isinstance(value, bool) or not isinstance(value, Integral) or not 0 <= value <= MAX_SEED:
        raise InvalidValueError("seed", value, f"a whole number from 0 to {MAX_SEED}")
    return int(value)


def robot_of(value: AnyRobot) -> RobotConfig:
    """Convert the argument ``robot`` to a configuration.

    Raises:
        DiffbotError: if the robot is unknown or a value of its description is not allowed.
    """
    if isinstance(value, RobotConfig):
        return value
    if not isinstance(value, (str, PathLike, RobotDescription)):
        raise InvalidValueError("robot", value, "a parameter file, a name in diffbot.ROBOTS, or diffbot.robot(...)")
    return read_robot(value)


def robot(like: str = "turtlebot3_burger", **values: Any) -> RobotConfig:
    """Return one of the ROBOTS with some values changed.

    Examples:
        >>> import diffbot
        >>> slow = diffbot.robot("turtlebot4", linear_x_max_velocity=0.1)
        >>> slow
        <Robot turtlebot4: 0.1 m/s, 1.9 rad/s, latency 0.12 s, tolerances 0.15 m and 0.15 rad>
        >>> diffbot.drive((0.5, 0.0, 0.0), robot=slow).duration > 5.0
        True

    Args:
        like: name of the robot in ROBOTS.
        values: new values, named as the options of ``diffbot robot new``, which are the parameters of the nodes with
            ``_`` in place of dots.

    Raises:
        InvalidValueError: if a name is unknown or a value is not allowed.
    """
    if like not in PRESETS:
        raise InvalidValueError("like", like, known_name(like, PRESETS))
    return read_robot(with_parameters(PRESETS[like], values))._replace(name=like)


def with_parameters(config: C, values: Mapping[str, Any]) -> C:
    """Return a configuration with some parameters changed; their names have ``_`` in place of dots.

    Raises:
        InvalidValueError: if a name is unknown or a value is not allowed.
    """
    names = {one.name.replace(".", "_"): one.name for one in parameters_of(type(config))}
    for name, value in values.items():
        if name not in names:
            raise InvalidValueError(name, value, known_name(name, names))
    return build(type(config), {names[name]: value for name, value in values.items()}, config)
