"""Records of goals: each goal has an id, is accepted or refused once, and ends once. Times in seconds."""

from __future__ import annotations

import math
import uuid
from collections import deque
from typing import NamedTuple

REACHED = "reached"
CANCELLED = "cancelled"
REPLACED = "replaced"
NOT_REACHED = "not reached"
POSE_LOST = "pose lost"
REFUSED = "refused"
ENDS = (REACHED, CANCELLED, REPLACED, NOT_REACHED, POSE_LOST, REFUSED)
"""All ends of a goal."""
HISTORY = 32
"""Number of ended goals whose records are kept and published."""
MAX_PATH_POSES = 2000
"""A longer path is refused."""
SUSPENSION = 2.0
"""[s] After a longer suspension the controller ends its goal, because its clients may have declared it lost."""
RESTART_TIMEOUT = 2.0
"""[s] grace period after the lease of ~/status (1 s) before a client declares the controller lost. DDS renews the lease
at least 2/3 s before its end, so a client waits longer than SUSPENSION."""
_MAX_IDS = 1000
"""Number of ids that are kept to recognise repeated messages."""


def goal_id(frame: str, stamp: int) -> str:
    """Return the id of the goal with this frame and stamp [ns]: 32 hexadecimal digits, a UUID of version 5."""
    return uuid.uuid5(uuid.NAMESPACE_OID, f"{frame} {stamp}").hex


def end_text(end: str, reason: str) -> str:
    """Return the end of a goal in words, such as ``not reached: no progress for 30 s, 1.20 m to go``."""
    return f"{end}: {reason}" if reason else end


class GoalRequest(NamedTuple):
    """Id and origin of a goal."""

    id: str = ""
    """32 hexadecimal digits; empty for a goal that is not reported"""
    source: str = ""
    """name of the topic on which the goal arrived, or ``action``"""
    time: float = math.nan
    """[s] time of arrival, on the caller's clock"""


ANONYMOUS = GoalRequest()


class GoalRecord(NamedTuple):
    """State and end of a goal or a path."""

    request: GoalRequest
    is_cancelling: bool = False
    """the goal was cancelled, and the robot still brakes"""
    end: str = ""
    """one of ENDS; empty before the end"""
    reason: str = ""
    """reason of the end; for a reached goal empty, or a fault of the inputs of the filter"""
    elapsed: float = 0.0
    """[s] from the acceptance to the end"""

    @property
    def text(self) -> str:
        """The end in words, with the reason if there is one."""
        return end_text(self.end, self.reason)


class GoalBook:
    """The current goal, and the goals that have ended."""

    def __init__(self) -> None:
        """Start without goals."""
        self.present: GoalRecord | None = None
        """the goal that was accepted and has not ended"""
        self.ended: deque[GoalRecord] = deque(maxlen=HISTORY)
        """the newest HISTORY records of ended goals, oldest first"""
        self._news: list[GoalRecord] = []
        self._ids: dict[str, None] = {}

    def knows(self, goal_id: str) -> bool:
        """Return True if a goal with this id was accepted or refused."""
        return goal_id in self._ids

    def accept(self, request: GoalRequest) -> None:
        """Open the record of a goal. The previous record must be closed."""
        self.present = GoalRecord(request)
        self._remember(request.id)

    def refuse(self, request: GoalRequest, end: str, reason: str) -> None:
        """Record the end of a goal that is not accepted; the current goal does not change."""
        self._remember(request.id)
        self._add(GoalRecord(request, end=end, reason=reason))

    def cancel(self, reason: str) -> None:
        """Mark the current goal as cancelled; the goal ends with this reason when the robot has come to rest."""
        if self.present is not None:
            self.present = self.present._replace(is_cancelling=True, reason=reason)

    def close(self, end: str, reason: str, elapsed: float) -> None:
        """End the current goal, if there is one; a cancelled goal always ends as cancelled, with its own reason."""
        if self.present is None:
            return
        if self.present.is_cancelling:
            end, reason = CANCELLED, self.present.reason
        record, self.present = self.present._replace(end=end, reason=reason, elapsed=elapsed), None
        self._add(record)

    @property
    def newest(self) -> GoalRecord | None:
        """The record of the goal that was accepted last; None before the first goal."""
        return self.present or next((one for one in reversed(self.ended) if one.end != REFUSED), None)

    def take_news(self) -> list[GoalRecord]:
        """Return the goals that have ended since the last call, oldest first."""
        news, self._news = self._news, []
        return news

    def _add(self, record: GoalRecord) -> None:
        self.ended.append(record)
        self._news.append(record)

    def _remember(self, goal_id: str) -> None:
        if goal_id:
            self._ids[goal_id] = None
            if len(self._ids) > _MAX_IDS:
                del self._ids[next(iter(self._ids))]
