"""The present goal in a file, so that a controller that is started again can drive on to it, or answer for it.

The file holds no times: the clock of the next start may be another one, as that of a simulation is. When the
controller was last alive is the time of the file itself.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, NamedTuple

from diffbot_control.ros.goals.request import MAX_YAW, checked_goal_id
from diffbot_core.errors import DiffbotError
from diffbot_core.files import PRIVATE, write_text
from diffbot_core.foreign_files import read_own
from diffbot_core.geometry import MAX_COORDINATE, Pose

_VERSION = 1
_MAX_BYTES_PER_POSE, _MAX_OTHER_BYTES = 100, 4096
MAX_COUNT = 1_000_000
"""goals of a path, as max_path_poses allows"""
_MAX_TEXT = 256
"""characters of a source or the name of a frame"""


class BrokenGoalError(DiffbotError):
    """A file that does not hold a valid goal, or is not this user's own."""


class SavedGoal(NamedTuple):
    """A goal, or what is left of a path."""

    id: str
    """32 hexadecimal digits"""
    source: str
    """topic, service or action"""
    frame: str
    """of the poses"""
    poses: list[Pose]
    """that are not passed yet; none of a goal that is being cancelled"""
    waypoint: int = 0
    """number of the first of them in its path, from 1; 0 for a single goal"""
    waypoints: int = 0
    """goals of the path"""
    is_cancelling: bool = False


def encode_poses(poses: list[Pose]) -> list[str]:
    """Return each pose as it is written; those of a long path are written again and again, but encoded once."""
    return [f"[{pose.x!r}, {pose.y!r}, {pose.theta!r}]" for pose in poses]


def save_goal(path: Path, goal: SavedGoal, encoded: list[str] | None = None) -> None:
    """Write a goal through a temporary file, so that the file is complete at any time; ``encoded``: its poses.

    Raises:
        OSError: if it cannot be written.
    """
    fields = {"version": _VERSION, **goal._asdict()}
    del fields["poses"]
    poses = ", ".join(encode_poses(goal.poses) if encoded is None else encoded)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, f'{json.dumps(fields)[:-1]}, "poses": [{poses}]}}\n', mode=PRIVATE)


def load_goal(path: Path, max_poses: int) -> SavedGoal | None:
    """Read a goal; None if there is no file.

    Raises:
        BrokenGoalError: in one line, if it does not hold a valid goal of at most ``max_poses`` poses, or others could
            have written it.
    """
    # A file of a longer path than max_path_poses allows is too long.
    limit = _MAX_OTHER_BYTES + _MAX_BYTES_PER_POSE * max_poses
    try:
        content = read_own(path, limit)
    except DiffbotError as error:
        raise BrokenGoalError(str(error)) from None
    if content is None:
        return None
    try:
        fields = json.loads(content.decode("utf-8"))
    except (ValueError, RecursionError):
        raise BrokenGoalError(f"{path} is no JSON") from None
    if not isinstance(fields, dict) or fields.get("version") != _VERSION:
        raise BrokenGoalError(f"{path} is no goal of version {_VERSION}")
    try:
        return _goal_of(fields, max_poses)
    except DiffbotError as error:
        raise BrokenGoalError(f"{path}: {error}") from None


def _goal_of(fields: dict[str, Any], max_poses: int) -> SavedGoal:
    is_cancelling = fields.get("is_cancelling")
    if not isinstance(is_cancelling, bool):
        raise DiffbotError("is_cancelling must be true or false")
    found = fields.get("poses")
    if not isinstance(found, list) or not (0 if is_cancelling else 1) <= len(found) <= max_poses:
        raise DiffbotError(f"poses must be a list of 1 to {max_poses} poses")
    poses = [_pose_of(numbers) for numbers in found]
    waypoint, waypoints = _count(fields, "waypoint"), _count(fields, "waypoints")
    # A path's last poses are left, a single goal has no number.
    is_whole = len(poses) == waypoints - waypoint + 1 if waypoints else waypoint == 0 and len(poses) == 1
    if not is_cancelling and not (is_whole and (not waypoints or waypoint > 0)):
        raise DiffbotError(f"waypoint {waypoint}/{waypoints} does not fit the number of poses, {len(poses)}")
    source, frame = _text(fields, "source"), _text(fields, "frame")
    return SavedGoal(checked_goal_id(fields.get("id")), source, frame, poses, waypoint, waypoints, is_cancelling)


def _pose_of(numbers: Any) -> Pose:
    if isinstance(numbers, list) and len(numbers) == len(Pose._fields):
        limits = MAX_COORDINATE, MAX_COORDINATE, MAX_YAW
        if all(_is_number(value, limit) for value, limit in zip(numbers, limits, strict=True)):
            return Pose(*map(float, numbers))
    raise DiffbotError(f"a pose must be x, y up to {MAX_COORDINATE:g} m and a heading up to {MAX_YAW:g} rad")


def _is_number(value: Any, limit: float) -> bool:
    # Neither nan nor a number beyond the range of floats passes.
    return isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) <= limit


def _count(fields: dict[str, Any], name: str) -> int:
    value = fields.get(name)
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= MAX_COUNT:
        raise DiffbotError(f"{name} must be a whole number from 0 to {MAX_COUNT}")
    return value


def _text(fields: dict[str, Any], name: str) -> str:
    value = fields.get(name)
    if not isinstance(value, str) or len(value) > _MAX_TEXT or not value.isprintable():
        raise DiffbotError(f"{name} must be a text of one line")
    return value
