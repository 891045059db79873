"""The goals of a controller: when each was accepted, and how it ended.

Goals come from goal_pose and from the controller's status, ends from goal_results.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

from diffbot_control.goals.record import NOT_REACHED, REACHED, goal_id
from diffbot_control.goals.states import AT_GOAL, NOT_AT_GOAL
from diffbot_core.geometry import Pose
from diffbot_tools.view.texts import BoundedTable, Status, number

MAX_GOALS = 2000
"""Number of goals that are kept. The oldest are dropped."""
PASSED = "passed"
"""End of a pose of a path when the robot drives on to the next pose."""
_STATUS_DELAY = 2.0
"""[s] Largest time between a message of goal_pose and the status that names its goal."""
_SAME = 1e-4
"""Relative difference below which two poses are equal, since the status has six digits of a pose."""
_STATE_ENDS = {AT_GOAL: REACHED, NOT_AT_GOAL: NOT_REACHED}


class Goal(NamedTuple):
    """A goal pose and how it ended."""

    time: float
    """[s] when it was accepted"""
    pose: Pose
    id: str = ""
    """all poses of a path have one id; empty before the controller's status names the goal"""
    is_earlier: bool = False
    """the goal was reached before the first message and is still held"""
    is_accepted: bool = True
    """False if only goal_pose has named the goal, and the controller's status has not"""
    is_requested: bool = False
    """a message of goal_pose has named the goal"""
    end: str = ""
    """one of diffbot_control.goals.record.ENDS, or PASSED; empty before the end"""
    reason: str = ""
    source: str = ""
    ended: float = math.nan
    """[s]"""
    elapsed: float = math.nan
    """[s] from the acceptance to the answer, by the controller"""


class GoalList:
    """Collects the goals of one controller."""

    def __init__(self) -> None:
        """Start without goals."""
        self.goals: list[Goal] = []
        self.count = 0
        """number of goals so far, without a goal that was reached before the first message"""
        self._named: tuple[Pose, str] | None = None
        """pose and id of the goal in the newest status with a goal"""
        self._stamps: BoundedTable[int, None] = BoundedTable(MAX_GOALS)
        self._results: BoundedTable[str, tuple[float, Status, bool]] = BoundedTable(MAX_GOALS)
        """time of the answer [s], result, and True if the controller stamped the time, by id"""

    @property
    def newest(self) -> Goal | None:
        """The newest goal, ended or not."""
        return self.goals[-1] if self.goals else None

    def add_request(self, time: float, frame: str, stamp: int, pose: Pose) -> Goal | None:
        """Process a message of goal_pose; return the goal if it is new.

        A client repeats its message, with its stamp [ns], until the controller has accepted the goal. If the recorder
        received the message late, the id shows which goal it requested.
        """
        if stamp and stamp in self._stamps:
            return None
        self._stamps[stamp] = None
        for index, goal in reversed(list(enumerate(self.goals))):
            is_near = abs(time - goal.time) <= _STATUS_DELAY and _is_same(goal.pose, pose)
            if not goal.is_requested and (is_near or (stamp and goal.id == goal_id(frame, stamp))):
                self.goals[index] = goal._replace(is_requested=True)
                return None
        return self._append(Goal(time, pose, is_accepted=False, is_requested=True))

    def add_status(self, time: float, status: Status) -> Goal | None:
        """Process a status of the controller; return the goal if it is new."""
        self._end_by_state(time, status)
        pose, named_id = goal_in(status.values), status.values.get("goal id", "")
        if pose is None:
            return None
        before, self._named = self._named, (pose, named_id)
        is_same_goal = before is not None and before[1] == named_id
        if before is not None and is_same_goal and _is_same(before[0], pose):
            return None
        if is_same_goal and "goal updates" in status.values and self.goals:
            self.goals[-1] = self.goals[-1]._replace(pose=pose)
            return None
        is_waypoint = is_same_goal and bool(named_id and self.goals)
        if is_waypoint:
            self.goals[-1] = self.goals[-1]._replace(end=PASSED, ended=time)
        is_earlier = before is None and status.message == AT_GOAL
        goal = None if is_earlier or is_waypoint else self._accept_request(time, pose, named_id)
        is_new = goal is None and not is_earlier
        if goal is None:
            self._append(Goal(time, pose, named_id, is_earlier))
        if not is_earlier and named_id in self._results:
            self._set_end(len(self.goals) - 1, *self._results[named_id])
        return self.goals[-1] if is_new else None

    def add_results(self, time: float, statuses: list[Status], is_exact: bool = False) -> list[Goal | Status]:
        """Process a message of goal_results; return the goals that have ended, and the results of unknown goals.

        A goal is unknown if it was refused, or if its result is received before the status that names the goal. The
        first message is latched: unknown goals in it ended before the recording, and are not returned.

        Args:
            time: of the answer [s].
            statuses: results of the last goals, old and new.
            is_exact: the controller stamped the time.
        """
        is_first, found = not self._results, list[Goal | Status]()
        for status in statuses:
            if status.name in self._results:
                continue
            self._results[status.name] = time, status, is_exact
            indexes = [at for at, goal in enumerate(self.goals) if goal.id == status.name and not goal.is_earlier]
            if indexes:
                self._set_end(indexes[-1], time, status, is_exact)
                found.append(self.goals[indexes[-1]])
            elif not is_first:
                found.append(status)
        return found

    def _append(self, goal: Goal) -> Goal:
        self.goals = [*self.goals[1 - MAX_GOALS :], goal]
        self.count += not goal.is_earlier
        return goal

    def _accept_request(self, time: float, pose: Pose, named_id: str) -> Goal | None:
        """Mark the requested goal with this pose as accepted; return None if goal_pose did not request it."""
        for index, goal in reversed(list(enumerate(self.goals))):
            is_near = abs(time - goal.time) <= _STATUS_DELAY
            if not goal.is_accepted and is_near and _is_same(goal.pose, pose):
                del self.goals[index]
                self.goals.append(goal._replace(time=time, id=named_id, is_accepted=True))
                return self.goals[-1]
        return None

    def _set_end(self, index: int, time: float, status: Status, is_exact: bool) -> None:
        reason, source = (status.values.get(key, "") for key in ("reason", "source"))
        goal, elapsed = self.goals[index], number(status.values.get("elapsed time [s]"))
        if not 0.0 <= elapsed < math.inf:
            elapsed = time - goal.time
        # The controller counts from the first pose after the goal. The recorder may receive the status late.
        accepted = time - elapsed if is_exact else max(goal.time, time - elapsed)
        for at, one in enumerate(self.goals[:index]):
            if one.id == goal.id:  # an earlier pose of the same path
                self.goals[at] = one._replace(time=min(one.time, accepted))
        self.goals[index] = goal._replace(
            time=accepted, end=status.message, reason=reason, source=source, ended=time, elapsed=elapsed
        )

    def _end_by_state(self, time: float, status: Status) -> None:
        """End the newest goal by the controller's state, for a bag without goal_results. A result replaces this end."""
        end, named_id = _STATE_ENDS.get(status.message, ""), status.values.get("goal id", "")
        accepted = [index for index, goal in enumerate(self.goals) if goal.is_accepted]
        if not end or not accepted:
            return
        goal = self.goals[accepted[-1]]
        if not (goal.end or goal.is_earlier) and named_id in ("", goal.id):
            self.goals[accepted[-1]] = goal._replace(end=end, reason=status.values.get("reason", ""), ended=time)


def goal_in(values: Mapping[str, str]) -> Pose | None:
    """Return the goal among the values of controller/status; None without a goal."""
    try:
        x, y, theta = map(float, values.get("goal", "").split())
    except ValueError:
        return None
    return Pose(x, y, theta) if math.isfinite(x + y + theta) else None


def _is_same(a: Pose, b: Pose) -> bool:
    return all(abs(p - q) <= _SAME * max(1.0, abs(p)) for p, q in zip(a, b, strict=True))
