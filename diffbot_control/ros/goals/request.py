"""Goals by request: the named values of the service ~/send_goal, written by the client and checked by the controller.

No standard service carries a pose and answers with a text, so the goal travels as the parameters of
rcl_interfaces/srv/SetParametersAtomically: ``goal_id`` (32 hexadecimal digits, dashes allowed), ``frame_id`` (by
default the controller's ``map_frame``) and ``x``, ``y`` [m], ``yaw`` [rad], each a number, or each a list of one
length for a path. A ``goal_id`` alone asks for the state of that goal.
"""

from __future__ import annotations

import math
import re
import uuid
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.parameter import parameter_value_to_python

from diffbot_control.ros.messages.fields import fill_pose
from diffbot_core.errors import InvalidValueError
from diffbot_core.geometry import MAX_COORDINATE, Pose
from diffbot_core.ranges import HEADING

NUMBERS = ("x", "y", "yaw")
NAMES = ("goal_id", "frame_id", *NUMBERS)
MAX_POSES = 1000
_MAX_YAW = HEADING[1]
"""[rad] larger angles have lost their meaning to rounding or to a mistaken unit."""
_MAX_SHOWN = 60
_ID = re.compile(r"[0-9a-f]{32}")


class SentGoal(NamedTuple):
    """A checked request."""

    id: str
    message: PoseStamped | Path | None
    """the goal or the path; None: a question about the state of the goal ``id``"""


def new_goal_id() -> str:
    """Return an id that no other goal has."""
    return uuid.uuid4().hex


def goal_request(goal_id: str, poses: Sequence[Pose], frame: str) -> SetParametersAtomically.Request:
    """Return the request for one goal, or for a path of several; no poses: the question about a goal."""
    values: dict[str, Any] = {"goal_id": goal_id}
    if poses:
        values["frame_id"] = frame
        for name, numbers in zip(NUMBERS, zip(*poses, strict=True), strict=True):
            values[name] = [float(number) for number in numbers] if len(poses) > 1 else float(numbers[0])
    return SetParametersAtomically.Request(parameters=[_parameter(name, value) for name, value in values.items()])


def _parameter(name: str, value: Any) -> Parameter:
    if isinstance(value, str):
        typed = ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=value)
    elif isinstance(value, list):
        typed = ParameterValue(type=ParameterType.PARAMETER_DOUBLE_ARRAY, double_array_value=value)
    else:
        typed = ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=value)
    return Parameter(name=name, value=typed)


def read_goal_request(request: SetParametersAtomically.Request, default_frame: str) -> SentGoal:
    """Check a request.

    Raises:
        InvalidValueError: naming field, value and bound.
    """
    values = _values_of(request)
    goal_id = _checked_goal_id(values.get("goal_id", ""))
    if not set(values) - {"goal_id"}:
        return SentGoal(goal_id, None)
    frame = values.get("frame_id", default_frame)
    if not isinstance(frame, str) or not frame:
        raise InvalidValueError("frame_id", _shown(frame), "the name of a frame")
    columns = _columns(values)
    if columns is None:
        numbers = [_number(name, values[name]) for name in NUMBERS]
        return SentGoal(goal_id, _stamped(Pose(*numbers), frame))
    message = Path()
    message.header.frame_id = frame
    message.poses = [_stamped(Pose(*numbers), frame) for numbers in zip(*columns, strict=True)]
    return SentGoal(goal_id, message)


def _checked_goal_id(value: Any) -> str:
    """Return an id as 32 lower-case hexadecimal digits, not all zero: that means *all goals* in a cancellation.

    Raises:
        InvalidValueError: if it is none.
    """
    digits = value.replace("-", "").lower() if isinstance(value, str) and len(value) <= _MAX_SHOWN else ""
    if not _ID.fullmatch(digits) or not digits.strip("0"):
        raise InvalidValueError("goal_id", _shown(value), "32 hexadecimal digits (a UUID), not all zero")
    return digits


def _values_of(request: SetParametersAtomically.Request) -> Mapping[str, Any]:
    values: dict[str, Any] = {}
    for parameter in request.parameters:
        name = parameter.name
        if name not in NAMES:
            raise InvalidValueError("field", _shown(name), "one of " + ", ".join(NAMES))
        if name in values:
            raise InvalidValueError(name, _shown(_python(parameter.value)), "given once")
        values[name] = _python(parameter.value)
    return values


def _python(value: ParameterValue) -> Any:
    try:
        found = parameter_value_to_python(value)
    except RuntimeError:  # a type that no parameter has
        return None
    return list(found) if hasattr(found, "__iter__") and not isinstance(found, str) else found


def _columns(values: Mapping[str, Any]) -> list[list[float]] | None:
    """Return the lists of x, y and yaw of a path, None for a single goal."""
    for name in NUMBERS:
        if name not in values:
            raise InvalidValueError(name, None, "given")
    lists = [name for name in NUMBERS if isinstance(values[name], list)]
    if not lists:
        return None
    length = len(values[lists[0]])
    if not 1 <= length <= MAX_POSES:
        raise InvalidValueError(lists[0], f"{length} values", f"from 1 to {MAX_POSES} values")
    for name in NUMBERS:
        if not isinstance(values[name], list) or len(values[name]) != length:
            raise InvalidValueError(name, _shown(values[name]), f"a list of {length} numbers, as {lists[0]} is")
    return [[_number(name, value) for value in values[name]] for name in NUMBERS]


def _number(name: str, value: Any) -> float:
    limit, unit = (_MAX_YAW, "rad") if name == "yaw" else (MAX_COORDINATE, "m")
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise InvalidValueError(name, _shown(value), f"a finite number [{unit}]")
    if abs(value) > limit:
        raise InvalidValueError(name, value, f"from {-limit:g} to {limit:g} {unit}")
    return float(value)


def _stamped(pose: Pose, frame: str) -> PoseStamped:
    message = PoseStamped()
    message.header.frame_id = frame
    fill_pose(message.pose, pose)
    return message


def _shown(value: Any) -> Any:
    """Return a value short enough for one line."""
    text = value if isinstance(value, str) else repr(value)
    return value if len(text) <= _MAX_SHOWN else text[:_MAX_SHOWN] + "..."
