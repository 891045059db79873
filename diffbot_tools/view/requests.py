"""Reads and checks the requests of browsers."""

from __future__ import annotations

import json
from collections.abc import Collection
from typing import Any, NamedTuple

from diffbot_core.errors import InvalidValueError
from diffbot_core.geometry import MAX_COORDINATE, Pose, wrap_angle

MAX_MESSAGE = 4096
"""[bytes] Largest request."""
POSES = ("goal", "initialpose")
SWITCHES = ("pause", "record")
ACTIONS = ("cancel", "reset", "dock", "undock")
_MAX_YAW = 1e3
_MAX_SHOWN = 40


class Request(NamedTuple):
    """A request of a browser."""

    kind: str
    """one of POSES, SWITCHES and ACTIONS"""
    robot: str
    pose: Pose | None = None
    """of a request in POSES"""
    is_on: bool = False
    """of a request in SWITCHES"""


def read_request(text: str | bytes, robots: Collection[str]) -> Request:
    """Return the request in a message of a browser.

    Raises:
        InvalidValueError: if the message is not valid. The error names the field, its value and the allowed values.
    """
    try:
        content = json.loads(text) if isinstance(text, str) else None
    except (ValueError, RecursionError):
        content = None
    if not isinstance(content, dict):
        raise InvalidValueError("message", _shown(text), "a JSON object")
    kind, robot = content.get("type"), content.get("robot")
    if not isinstance(kind, str) or kind not in POSES + SWITCHES + ACTIONS:
        raise InvalidValueError("type", _shown(kind), "one of " + ", ".join(POSES + SWITCHES + ACTIONS))
    if not isinstance(robot, str) or robot not in robots:
        raise InvalidValueError("robot", _shown(robot), "one of the robots on the page")
    if kind in POSES:
        x, y = (_number(content, name, MAX_COORDINATE) for name in ("x", "y"))
        return Request(kind, robot, Pose(x, y, wrap_angle(_number(content, "yaw", _MAX_YAW))))
    if kind in SWITCHES:
        is_on = content.get("on")
        if not isinstance(is_on, bool):
            raise InvalidValueError("on", _shown(is_on), "true or false")
        return Request(kind, robot, is_on=is_on)
    return Request(kind, robot)


def _number(content: dict[str, Any], name: str, limit: float) -> float:
    value = content.get(name)
    # An integer from JSON can be too large for a float, so it is compared before it is converted.
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not -limit <= value <= limit:
        raise InvalidValueError(name, _shown(value), f"a number from {-limit:g} to {limit:g}")
    return float(value)


def _shown(value: object) -> str:
    text = value if isinstance(value, str) else repr(value)[: 2 * _MAX_SHOWN]
    return text if len(text) <= _MAX_SHOWN else text[:_MAX_SHOWN] + "..."
