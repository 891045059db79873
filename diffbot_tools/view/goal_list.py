"""The goals of a robot, from goal_pose and the controller's status, and their ends, from goal_results."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

from diffbot_control.goals.record import NOT_REACHED, REACHED, goal_id
from diffbot_control.goals.states import AT_GOAL, NOT_AT_GOAL
from diffbot_core.geometry import Pose
from diffbot_tools.view.texts import BoundedTable, Status, number

MAX_GOALS = 2000
"""Goals that are kept of a robot; beyond this number, the oldest are dropped."""
PASSED = "passed"
"""End of a pose of a path when the robot goes on to the next pose."""
_STATUS_DELAY = 2.0
"""[s] between a message of goal_pose and the status that names its goal"""
_SAME = 1e-4
"""The status has six digits of a pose."""
_STATE_ENDS = {AT_GOAL: REACHED, NOT_AT_GOAL: NOT_REACHED}


class Goal(NamedTuple):
    """A goal pose and how it ended."""

    time: float
    """[s] when it was accepted"""
    pose: Pose
    id: str = ""
    """all poses of a path have one id; empty: the controller's status does not name it"""
    is_earlier: bool = False
    """the goal was reached before the first message and is still held"""
    is_named: bool = True
    """the controller's status has named it; if not, only goal_pose has"""
    is_requested: bool = False
    """a message of goal_pose has named it"""
    end: str = ""
    """one of diffbot_control.goals.record.ENDS, or PASSED; empty before the end"""
    reason: str = ""
    source: str = ""
    ended: float = math.nan
    """[s]"""
    elapsed: float = math.nan
    """[s] from the acceptance to the answer, by the controller"""


class GoalList:
    """Collects the goals of one robot."""

    def __init__(self) -> None:
        """Start without goals."""
        self.goals: list[Goal] = []
        self.count = 0
        """goals so far, without the goal that was reached before the first message"""
        self._named: tuple[Pose, str] | None = None
        """pose and id in the newest status with a goal"""
        self._was_named = False
        self._stamps: BoundedTable[int, None] = BoundedTable(MAX_GOALS)
        self._results: BoundedTable[str, tuple[float, Status, bool]] = BoundedTable(MAX_GOALS)
        """results by id, with the time of the answer [s], and whether the controller has stamped it"""

    @property
    def newest(self) -> Goal | None:
        """The newest goal, ended or not."""
        return self.goals[-1] if self.goals else None

    def take_request(self, time: float, frame: str, stamp: int, pose: Pose) -> Goal | None:
        """Process a message of goal_pose; return the goal if it is new.

        A client repeats its message, with its stamp [ns], until the controller has accepted the goal. A message that a
        recorder received late belongs to the goal that has its id.
        """
        if stamp and stamp in self._stamps:
            return None
        self._stamps[stamp] = None
        for index, goal in reversed(list(enumerate(self.goals))):
            is_near = abs(time - goal.time) <= _STATUS_DELAY and _is_same(goal.pose, pose)
            if not goal.is_requested and (is_near or (stamp and goal.id == goal_id(frame, stamp))):
                self.goals[index] = goal._replace(is_requested=True)
                return None
        return self._append(Goal(time, pose, is_named=False, is_requested=True))

    def take_status(self, time: float, status: Status) -> Goal | None:
        """Process a status of the controller; return the goal if it is new."""
        self._end_by_state(time, status)
        pose, named_id = goal_in(status.values), status.values.get("goal id", "")
        was_named, self._was_named = self._was_named, pose is not None
        if pose is None:
            return None
        before, self._named = self._named, (pose, named_id)
        is_same_goal = before is not None and before[1] == named_id
        # Without ids, a goal after a status without a goal is another goal.
        if before is not None and is_same_goal and _is_same(before[0], pose) and (named_id or was_named):
            return None
        if is_same_goal and "goal updates" in status.values and self.goals:
            self.goals[-1] = self.goals[-1]._replace(pose=pose)
            return None
        is_waypoint = is_same_goal and bool(named_id and self.goals)
        if is_waypoint:
            self.goals[-1] = self.goals[-1]._replace(end=PASSED, ended=time)
        is_earlier = before is None and status.message == AT_GOAL
        goal = self._claimed(Goal(time, pose, named_id, is_earlier)) if not (is_earlier or is_waypoint) else None
        is_new = goal is None
        goal = goal or self._append(Goal(time, pose, named_id, is_earlier))
        if not is_earlier and named_id in self._results:
            self._set_end(len(self.goals) - 1, *self._results[named_id])
        return self.goals[-1] if is_new and not is_earlier else None

    def take_results(self, time: float, statuses: list[Status], is_exact: bool = False) -> list[Goal | Status]:
        """Process a message of goal_results; return the goals that have ended, and the results of unknown goals.

        A goal is unknown if it was refused, or if its result is received before the status that names it. The first
        message is latched, so its unknown goals ended earlier and are not returned.
        """
        is_first, found = not self._results, list[Goal | Status]()
        for status in statuses:
            if status.name in self._results:
                continue
            self._results[status.name] = time, status, is_exact
            if (index := self._index_of(time, status)) is not None:
                self._set_end(index, time, status, is_exact)
                found.append(self.goals[index])
            elif not is_first:
                found.append(status)
        return found

    def _append(self, goal: Goal) -> Goal:
        self.goals = [*self.goals[1 - MAX_GOALS :], goal]
        self.count += not goal.is_earlier
        return goal

    def _claimed(self, named: Goal) -> Goal | None:
        """Find the goal of goal_pose that a status names, and set its id; None if there is no such goal."""
        for index, goal in reversed(list(enumerate(self.goals))):
            is_near = abs(named.time - goal.time) <= _STATUS_DELAY
            if not goal.is_named and is_near and _is_same(goal.pose, named.pose):
                del self.goals[index]
                self.goals.append(goal._replace(time=named.time, id=named.id, is_named=True))
                return self.goals[-1]
        return None

    def _index_of(self, time: float, status: Status) -> int | None:
        """Return the index of the goal of a result.

        Recordings of old controllers have no ids of goals. There, a result belongs to the goal whose acceptance fits
        the elapsed time best; without an elapsed time, to the oldest goal without a result.
        """
        indexes = [index for index, goal in enumerate(self.goals) if goal.id == status.name and not goal.is_earlier]
        if indexes or any(goal.id for goal in self.goals):
            return indexes[-1] if indexes else None
        is_open = [
            index
            for index, goal in enumerate(self.goals)
            if math.isnan(goal.elapsed) and not goal.source and goal.time <= time and not goal.is_earlier
        ]
        elapsed = number(status.values.get("elapsed time [s]"))
        if not is_open or math.isnan(elapsed):
            return is_open[0] if is_open else None
        return min(is_open, key=lambda index: abs(self.goals[index].time - (time - elapsed)))

    def _set_end(self, index: int, time: float, status: Status, is_exact: bool) -> None:
        reason, source = (status.values.get(key, "") for key in ("reason", "source"))
        elapsed = number(status.values.get("elapsed time [s]"))
        goal = self.goals[index]
        elapsed = time - goal.time if math.isnan(elapsed) else elapsed
        # The controller counts from the first pose after the goal.
        self.goals[index] = goal._replace(
            # The status with the goal may have been received late, too.
            time=time - max(elapsed, 0.0) if is_exact else max(goal.time, time - max(elapsed, 0.0)),
            end=status.message,
            reason=reason,
            source=source,
            ended=time,
            elapsed=max(elapsed, 0.0),
        )

    def _end_by_state(self, time: float, status: Status) -> None:
        """End the newest goal by the controller's state, for recordings without results; a result replaces this end."""
        end, named_id = _STATE_ENDS.get(status.message, ""), status.values.get("goal id", "")
        named = [index for index, goal in enumerate(self.goals) if goal.is_named]
        if not end or not named:
            return
        goal = self.goals[named[-1]]
        if not (goal.end or goal.is_earlier) and named_id in ("", goal.id):
            self.goals[named[-1]] = goal._replace(end=end, reason=status.values.get("reason", ""), ended=time)


def goal_in(values: Mapping[str, str]) -> Pose | None:
    """Return the goal among the values of controller/status; None without a goal."""
    try:
        x, y, theta = map(float, values.get("goal", "").split())
    except ValueError:
        return None
    return Pose(x, y, theta) if math.isfinite(x + y + theta) else None


def _is_same(a: Pose, b: Pose) -> bool:
    return all(abs(p - q) <= _SAME * max(1.0, abs(p)) for p, q in zip(a, b, strict=True))
