"""How each goal of a recording ended: ends are matched to goals by the goal's id."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from typing import NamedTuple

from diffbot_control.goals.goal_record import REPLACED
from diffbot_tools.view.events import Event
from diffbot_tools.view.goals import GoalSent

PASSED = "passed"
"""End of a pose of a path when the robot goes on to the next pose."""
_RESULT_DELAY = 0.5
"""[s] between a goal that replaces another one and the result of the other one"""


class GoalEnd(NamedTuple):
    """The end of a goal."""

    words: str = ""
    """such as ``reached [request]``; empty: unknown"""
    time: float | None = None
    """[s]; None: unknown"""
    elapsed: float = math.nan
    """[s] since the goal was sent, which may be before the recording"""


def ends_of(goals: Sequence[GoalSent], events: Sequence[Event]) -> list[GoalEnd]:
    """Return the end of each goal.

    Args:
        goals: in the order of time.
        events: in the order of time.
    """
    ends = [event for event in events if event.kind == "end"]
    by_id = {event.goal: event for event in ends if event.goal}
    last_of_id = {goal.id: index for index, goal in enumerate(goals)}
    without_id = _matched_by_time(goals, [event for event in ends if not event.goal or event.goal not in last_of_id])
    found = []
    for index, goal in enumerate(goals):
        following = goals[index + 1].time if index + 1 < len(goals) else math.inf
        if goal.id and last_of_id[goal.id] != index:
            found.append(GoalEnd(PASSED, following, following - goal.time))
            continue
        event = by_id.get(goal.id) if goal.id else without_id.get(index)
        if event is None:
            found.append(GoalEnd() if ends else _end_by_state(events, goal.time, following))
            continue
        since = event.time - goal.time
        elapsed = since if math.isnan(event.elapsed) else max(since, event.elapsed)
        found.append(GoalEnd(event.text.removeprefix("goal "), event.time, elapsed))
    return found


def _matched_by_time(goals: Sequence[GoalSent], ends: Sequence[Event]) -> dict[int, Event]:
    """Match ends to the goals whose id is unknown, in recordings of controllers that do not name it in their status.

    Goals end in the order in which they were sent, so that the last end is matched first. An end belongs to the goal
    that was sent its elapsed time before. Without that time, it belongs to the newest goal before it, or, if that goal
    has replaced another one, to the goal that was replaced.
    """
    unnamed = [index for index, goal in enumerate(goals) if not goal.id]
    times = [goals[index].time for index in unnamed]
    found: dict[int, Event] = {}
    open_goals = len(unnamed)
    for event in reversed(ends):
        open_goals = min(open_goals, bisect_right(times, event.time))
        if event.text.startswith(f"goal {REPLACED}"):
            open_goals = min(open_goals, bisect_right(times, event.time + _RESULT_DELAY) - 1)
        if open_goals <= 0:
            break
        chosen = open_goals - 1
        if not math.isnan(event.elapsed):
            began = event.time - event.elapsed
            later = min(bisect_left(times, began, 0, open_goals), chosen)
            chosen = min(max(later - 1, 0), later, key=lambda index: abs(times[index] - began))
        found[unnamed[chosen]] = event
        open_goals = chosen
    return found


def _end_by_state(events: Sequence[Event], begin: float, following: float) -> GoalEnd:
    """Return the end that the controller's state tells until the next goal, for recordings without results."""
    for event in events:
        state = event.text.partition(": ")[2]
        if event.kind == "state" and begin < event.time <= following and state.startswith("goal "):
            return GoalEnd(state.removeprefix("goal "), event.time, event.time - begin)
    return GoalEnd()
