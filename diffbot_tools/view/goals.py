"""The goals of a robot, from goal_pose and from the controller's status, for a bag as for a live robot."""

from __future__ import annotations

import math
from collections.abc import Mapping
from enum import Enum
from typing import NamedTuple

import numpy as np

from diffbot_control.goals.states import AT_GOAL
from diffbot_core.geometry import MAX_COORDINATE, Pose, yaw_of_quaternion
from diffbot_core.units import S_PER_NS
from diffbot_tools.view.bag_tables import RobotTables
from diffbot_tools.view.clock import Clock
from diffbot_tools.view.texts import Status

MAX_GOALS = 2000
"""of a robot that are shown; later ones are left out"""
_STATUS_DELAY = 2.0
"""[s] between a goal and the status that names it"""
_SAME = 1e-4
"""The status has six digits of a pose."""


class GoalSent(NamedTuple):
    """A goal pose and when it was received."""

    time: float
    """[s]"""
    pose: Pose
    id: str = ""
    """The poses of a path share one id. Empty: the controller's status does not name the id of this goal."""
    is_earlier: bool = False
    """The goal was reached before the first message and is still held."""


class Change(Enum):
    """What a status says of the goal, compared with the status before."""

    NONE = "the same goal, or no goal"
    NEW = "another goal, or the next pose of a path"
    CORRECTED = "another pose of the same goal"
    EARLIER = "a goal that was reached before the first status"


class GoalWatch:
    """Compares the goals that the statuses of a controller name, in their order."""

    def __init__(self) -> None:
        """Start without a status."""
        self.pose: Pose | None = None
        """of the newest goal"""
        self.id = ""
        """of the newest goal"""
        self._is_named = False
        """the status before names a goal"""

    def take(self, status: Status) -> Change:
        """Take the next status; pose and id of its goal are then those of this object."""
        pose, goal_id = goal_in(status.values), goal_id_in(status.values)
        was_named, self._is_named = self._is_named, pose is not None
        if pose is None:
            return Change.NONE
        before, is_same_goal = self.pose, self.pose is not None and goal_id == self.id
        # Without ids, a goal that comes after none is another one.
        if before is not None and is_same_goal and _is_same(before, pose) and (goal_id or was_named):
            return Change.NONE
        self.pose, self.id = pose, goal_id
        if before is None and status.message == AT_GOAL:
            return Change.EARLIER
        return Change.CORRECTED if is_same_goal and "goal updates" in status.values else Change.NEW


def goal_in(values: Mapping[str, str]) -> Pose | None:
    """Return the goal among the values of controller/status, None if there is none."""
    try:
        x, y, theta = map(float, values.get("goal", "").split())
    except ValueError:
        return None
    return Pose(x, y, theta) if np.isfinite([x, y, theta]).all() else None


def goal_id_in(values: Mapping[str, str]) -> str:
    """Return the id of the goal among the values of controller/status; empty if there is none."""
    return values.get("goal id", "") if "goal" in values else ""


def _is_same(a: Pose, b: Pose) -> bool:
    return all(abs(p - q) <= _SAME * max(1.0, abs(p)) for p, q in zip(a, b, strict=True))


def goals_of(robot: RobotTables, clock: Clock) -> list[GoalSent]:
    """Return the goals of goal_pose, and those that only the controller's status names: of a service, action or path.

    A goal that was corrected has its last pose.
    """
    topic = _goals_of_topic(robot, clock)
    times, poses = np.array([one.time for one in topic]), np.array([one.pose for one in topic]).reshape(-1, 3)
    is_free = np.ones(len(topic), dtype=bool)
    watch, found, since = GoalWatch(), list[GoalSent](), -math.inf
    for log_time, status in robot.texts.get("controller", []):
        time, change, before = clock.of_log_time(log_time), watch.take(status), found[-1] if found else None
        if watch.pose is None or change is Change.NONE:
            continue
        if before is not None and change is Change.CORRECTED:
            found[-1] = before._replace(pose=watch.pose)
            continue
        goal = GoalSent(time, watch.pose, watch.id, change is Change.EARLIER)
        is_waypoint = before is not None and goal.id != "" and goal.id == before.id
        # The message of goal_pose that this status is about: the nearest one in time with the same pose.
        if not (is_waypoint or goal.is_earlier):
            first, last = np.searchsorted(times, (since - _STATUS_DELAY, time + _STATUS_DELAY))
            is_near = np.abs(poses[first:last] - goal.pose) <= _SAME * np.maximum(1.0, np.abs(goal.pose))
            same = first + np.flatnonzero(is_free[first:last] & is_near.all(axis=1))
            if len(same):
                index = same[np.argmin(np.abs(times[same] - time))]
                is_free[index] = False
                goal = goal._replace(time=topic[index].time)
            since = time
        found.append(goal)
    found += [one for one, is_unnamed in zip(topic, is_free, strict=True) if is_unnamed]
    return sorted(found, key=lambda one: one.time)[:MAX_GOALS]


def _goals_of_topic(robot: RobotTables, clock: Clock) -> list[GoalSent]:
    """Return the goals of goal_pose in the order of time."""
    if (table := robot.tables.get("goals")) is None:
        return []
    found = []
    for stamp, log_time, row in zip(table.stamps.tolist(), table.log_times.tolist(), table.numbers, strict=True):
        x, y, qx, qy, qz, qw = row.tolist()
        yaw = yaw_of_quaternion(qx, qy, qz, qw)
        # A goal from a command line has no stamp.
        time = (stamp - clock.origin) * S_PER_NS if stamp >= clock.origin else clock.of_log_time(log_time)
        if np.isfinite([x, y, yaw]).all() and max(abs(x), abs(y)) <= MAX_COORDINATE:
            found.append(GoalSent(time, Pose(x, y, yaw)))
    return sorted(found, key=lambda one: one.time)
