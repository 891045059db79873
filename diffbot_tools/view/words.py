"""The state line: the state of a robot in words, for the live page and the report."""

from __future__ import annotations

import math
from math import degrees
from typing import NamedTuple

from diffbot_control.goals.states import AT_GOAL
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist
from diffbot_tools.view.texts import ERROR, OK, WARNING, Status

Words = tuple[int, str]
"""Level (OK, WARNING, ERROR) and text."""
_AT_REST = Twist(0.02, 0.05)
"""[m/s], [rad/s] largest speeds of a robot at rest"""
_NAN = math.nan


class RobotSituation(NamedTuple):
    """Values that determine the state line."""

    controller: Status = Status(OK, "", "", {})
    """newest status of the controller; its message is empty before the first status"""
    filter: str = ""
    """reason why the filter does not publish poses; empty if it publishes them"""
    docking: Words | None = None
    """see docking_words; None if the robot is neither docking nor docked"""
    to_go: Pose = Pose(_NAN, _NAN, _NAN)
    """pose of the robot in the frame of the goal; nan without a goal"""
    speed: Twist = Twist(_NAN, _NAN)
    """measured speed"""
    left: float = _NAN
    """[s] until the goal is reached, as the controller estimates; nan: unknown"""
    silence: Words | None = None
    """level and text if the controller does not send its status; else None"""
    is_paused: bool = False
    """the simulation is paused"""


def length_text(metres: float) -> str:
    """Return a length as text, in centimetres below one metre."""
    return f"{100.0 * metres:.1f} cm" if metres < 0.995 else f"{metres:.2f} m"


def state_words(now: RobotSituation, tolerance: float) -> Words:
    """Return level and text of the state line; ``tolerance`` [m] is the tolerance of a goal's position."""
    status = now.controller
    text, reason = status.message, status.values.get("reason", "")
    if now.is_paused:
        return OK, "paused"
    if now.silence is not None:
        return now.silence
    if now.docking is not None and text != "driving":
        return now.docking
    waiting = f": {now.filter}" if now.filter else ""
    fixed = {
        "stale pose": (ERROR, f"stopped: {now.filter or 'no pose is received'}"),
        "goal not reached": (ERROR, f"gave up: {reason}" if reason else "gave up"),
        "waiting for pose": (WARNING, f"goal accepted, waiting for a pose{waiting}"),
        "tolerance below uncertainty": (
            WARNING,
            "at rest near the goal, but the pose is too uncertain to report it as reached",
        ),
        "cancelling": (OK, "braking: goal cancelled"),
        "inactive": (OK, "controller inactive"),
        "idle": (OK, f"idle, filter{waiting}" if waiting else "idle"),
    }
    if text == "driving":
        return OK, _driving(now)
    if text == AT_GOAL:
        return _at_goal(now, tolerance)
    return fixed.get(text, (min(status.level, ERROR), f"{text}: {reason}" if reason else text))


def docking_words(status: Status, before: Words | None) -> Words | None:
    """Return level and text of the docking; None if the robot is neither docking nor docked.

    Args:
        status: newest status of the docking controller.
        before: result for the previous status. A docked robot stays docked until it drives again.
    """
    values, was = status.values, before[1] if before else ""
    is_docking = values["goal"].split() == ["0", "0", "0"] if "goal" in values else not was.startswith("undocking")
    if status.message == AT_GOAL:
        return (OK, "docked") if is_docking else None
    if "goal" not in values:
        return before if was == "docked" else None
    verb = "docking" if is_docking else "undocking"
    if status.message != "driving":
        return min(status.level, ERROR), f"{verb}: {status.message}"
    broken_off = values.get("approaches broken off", "0")
    phase = values.get("phase", "driving")
    text = verb if phase == verb else f"{verb}: {phase}"
    return (OK, text) if broken_off == "0" else (WARNING, f"{text}, approaches broken off: {broken_off}")


def _driving(now: RobotSituation) -> str:
    waypoint = now.controller.values.get("waypoint", "")
    where = f" (goal {waypoint})" if waypoint else ""
    return f"driving{where}{_to_go_text(now.to_go)}" + (f", {now.left:.0f} s" if now.left >= 0.5 else "")


def _at_goal(now: RobotSituation, tolerance: float) -> Words:
    distance = math.hypot(now.to_go.x, now.to_go.y)
    if abs(now.speed.v) > _AT_REST.v or abs(now.speed.omega) > _AT_REST.omega:
        return OK, f"moving after the goal was reached{_to_go_text(now.to_go)}"
    if distance > 2.0 * tolerance:
        return WARNING, f"away from the goal that was reached{_to_go_text(now.to_go)}"
    text = "holding" if "goal" in now.controller.values else "at the goal"
    return OK, text + (f", {length_text(distance)} off" if math.isfinite(distance) else "")


def _to_go_text(to_go: Pose) -> str:
    distance = math.hypot(to_go.x, to_go.y)
    if not math.isfinite(distance):
        return ""
    return f": {length_text(distance)} and {degrees(abs(to_go.theta)):.0f} deg to go"
