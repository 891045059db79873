"""Goals with an identity: each goal is accepted once and ends once. Free of ROS; the caller brings the times [s]."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from typing import NamedTuple

from diffbot_core.geometry import Pose

REACHED = "reached"
CANCELLED = "cancelled"
REPLACED = "replaced"
NOT_REACHED = "not reached"
POSE_LOST = "pose lost"
ENDS = (REACHED, CANCELLED, REPLACED, NOT_REACHED, POSE_LOST)
"""How a goal can end."""
HISTORY = 32
"""Ended goals that are remembered: a request that is repeated this late is still recognised."""
RESTART_TIMEOUT = 1.0
"""[s] for which a client lets a controller be away, after its lease of a second; a restart takes longer"""
MAX_PATH_POSES = 10_000
"""Default of the parameter max_path_poses."""
_MIN_SHARE = 0.05
"""Share of the distance to cover before the mean speed so far is meaningful."""


class GoalRequest(NamedTuple):
    """Where a goal comes from."""

    id: str = ""
    """32 hexadecimal digits; empty: nobody will ask for it"""
    source: str = ""
    """topic, service or action"""
    time: float = math.inf
    """[s] of its arrival, on the clock of :meth:`Supervisor.on_pose`; inf: unknown"""


ANONYMOUS = GoalRequest()


class GoalRecord(NamedTuple):
    """What is known of a goal or a path."""

    request: GoalRequest
    is_cancelling: bool = False
    """it was cancelled, and the robot is still braking"""
    end: str = ""
    """one of ENDS; empty before"""
    reason: str = ""
    """of the end, where there is more to say"""
    ended: float = math.nan
    """[s]"""

    def elapsed(self, now: float) -> float:
        """Return the time [s] from arrival to the end, or to ``now``; never negative."""
        return max((self.ended if self.end else now) - self.request.time, 0.0)


class GoalBook:
    """The present goal and those that have ended."""

    def __init__(self) -> None:
        """Start without goals."""
        self.present: GoalRecord | None = None
        """accepted and not ended"""
        self.ended: deque[GoalRecord] = deque(maxlen=HISTORY)
        """oldest first"""
        self.now = 0.0
        """[s] time of the newest event, set by the owner"""
        self._news: list[GoalRecord] = []

    def accept(self, request: GoalRequest) -> None:
        """Open the record of a goal; the one before has to be closed."""
        self.present = GoalRecord(request)

    def count_time_from(self, now: float) -> None:
        """Count the time of the present goal from ``now`` on: it came before the clock was known."""
        if self.present is not None:
            self.present = self.present._replace(request=self.present.request._replace(time=now))

    def cancel(self) -> None:
        """Note that the present goal is cancelled: it ends when the robot has come to rest."""
        if self.present is not None:
            self.present = self.present._replace(is_cancelling=True)

    def close(self, end: str, reason: str = "") -> None:
        """End the present goal, if there is one; a cancelled goal ends as cancelled, whatever ends it."""
        if self.present is None:
            return
        if self.present.is_cancelling:
            end, reason = CANCELLED, ""
        record = self.present._replace(end=end, reason=reason, ended=self.now)
        self.present = None
        self.ended.append(record)
        self._news.append(record)

    def find(self, goal_id: str) -> GoalRecord | None:
        """Return the newest record of a goal, None if it is unknown."""
        known = [*self.ended, self.present] if self.present is not None else list(self.ended)
        return next((record for record in reversed(known) if goal_id and record.request.id == goal_id), None)

    @property
    def newest(self) -> GoalRecord | None:
        """The record of the goal accepted last, ended or not; None before the first goal."""
        return self.present or (self.ended[-1] if self.ended else None)

    def take_news(self) -> list[GoalRecord]:
        """Return the goals that have ended since the last call, oldest first."""
        news, self._news = self._news, []
        return news

    @property
    def has_news(self) -> bool:
        """True if a goal has ended since the last :meth:`take_news`."""
        return bool(self._news)


def distance_along(pose: Pose, goals: Iterable[Pose]) -> float:
    """Return the length [m] of the straight lines from ``pose`` through all ``goals``."""
    length, last = 0.0, pose
    for goal in goals:
        length += math.hypot(goal.x - last.x, goal.y - last.y)
        last = goal
    return length


def time_remaining(distance: float, first_distance: float, elapsed: float, max_speed: float) -> float:
    """Estimate the time [s] to the goal from the mean speed so far, at first from the speed limit.

    Args:
        distance: [m] that remains.
        first_distance: [m] that remained when the goal was accepted.
        elapsed: [s] since then.
        max_speed: [m/s] limit; may be infinite, or 0 for a robot that must not move.
    """
    covered = first_distance - distance
    if covered > _MIN_SHARE * first_distance and elapsed > 0.0:
        return distance * elapsed / covered
    return distance / max_speed if max_speed > 0.0 else math.inf
