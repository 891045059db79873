"""What happened during a run, as a list: goals and their ends, states, switches of the region, rejections, faults."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping
from math import degrees
from typing import Any, NamedTuple

import numpy as np

from diffbot_control.goals.states import AT_GOAL
from diffbot_control.law.regions import REGION_NAMES
from diffbot_core.geometry import Pose
from diffbot_core.units import S_PER_NS
from diffbot_tools.view.bag_tables import RobotTables, Timed
from diffbot_tools.view.bounded_table import BoundedTable
from diffbot_tools.view.clock import Clock, Columns
from diffbot_tools.view.goals import GoalSent, goal_id_in
from diffbot_tools.view.texts import LogLine, Status, number

OK, WARNING, ERROR = 0, 1, 2
MAX_EVENTS = 10_000
"""of a kind that are kept of a robot; later ones are left out"""
MAX_NAMES = 1000
"""of nodes, goals and counters whose last message is remembered"""
_LEAP = 1.0
"""[s]; less may be a delay"""
_LEVEL_OF_END = {"reached": OK, "cancelled": OK, "replaced": OK}
_WARNING_LINE, _ERROR_LINE = 30, 40
_REJECTED, _RELOCATED = " rejected", "relocations by "


class Event(NamedTuple):
    """One line of the list."""

    time: float
    """[s]"""
    kind: str
    """goal, end, state, switch, rejection, relocation, fault"""
    level: int
    text: str
    goal: str = ""
    """of kind ``end``: id of the goal that has ended"""
    elapsed: float = math.nan
    """[s] of kind ``end``: time that the controller needed; nan: unknown"""

    @property
    def row(self) -> tuple[float, str, int, str]:
        """The event as the page takes it."""
        return self[:4]


class EventMaker:
    """Turns the messages of one robot, in the order of time, into events: for a bag as for a live robot."""

    def __init__(self, namespace: str = "", *, names_goals: bool = False) -> None:
        """Start without events.

        Args:
            namespace: such as ``/robot1``; messages of other nodes in /diagnostics and /rosout are ignored.
            names_goals: the controller's status names the id of its goal. Found out from the first status otherwise.
        """
        self._namespace = namespace
        self._names_goals: bool | None = names_goals or None
        self._goals: BoundedTable[str, None] = BoundedTable(MAX_NAMES)
        """ids of the goals that the status has named"""
        self._has_results = False
        self._states: dict[str, str] = {}
        self._counts: BoundedTable[str, int] = BoundedTable(MAX_NAMES)
        self._ends: BoundedTable[str, None] = BoundedTable(MAX_NAMES)
        self._faults: BoundedTable[str, str] = BoundedTable(MAX_NAMES)
        self._region: float | None = None

    def of_goal(self, time: float, count: int, pose: Pose) -> Event:
        """Return the event of a new goal, the ``count``-th one."""
        text = f"goal {count}: x {pose.x:.2f} m, y {pose.y:.2f} m, {degrees(pose.theta):.0f} deg"
        return Event(time, "goal", OK, text)

    def of_status(self, time: float, who: str, status: Status) -> list[Event]:
        """Return the events of a ~/status: a new state, and counters of the filter that have grown."""
        found = []
        if who == "controller":
            self._note_goal(status)
        if status.message != self._states.get(who, ""):
            reason = status.values.get("reason", "")
            text = f"{_short(status.name)}: {status.message}" + (f" ({reason})" if reason else "")
            found.append(Event(time, "state", min(status.level, ERROR), text))
        self._states[who] = status.message
        for key, value in status.values.items():
            is_relocation = key.startswith(_RELOCATED)
            if not (is_relocation or key.endswith(_REJECTED)) or not value.isdigit():
                continue
            count = int(value[:15])
            if (more := count - self._counts.get(key, 0)) > 0:
                kind = "relocation" if is_relocation else "rejection"
                words = key.replace("relocations", "filter relocated") if is_relocation else f"{key}: {more} more"
                found.append(Event(time, kind, WARNING, f"{words}, {count} in all"))
            self._counts[key] = count
        return found

    def _note_goal(self, status: Status) -> None:
        goal_id, is_named = goal_id_in(status.values), "goal" in status.values
        # A goal that is held in the first status was reached before it.
        if goal_id and (self._goals or status.message != AT_GOAL):
            self._goals[goal_id] = None
        if self._names_goals is None or is_named:
            self._names_goals = bool(goal_id) or not is_named

    def of_results(self, time: float, statuses: list[Status]) -> list[Event]:
        """Return the ends of goals that are new in ~/goal_results.

        The first message is latched: goals in it that the status has never named ended before it.
        """
        found = []
        is_latched, self._has_results = self._names_goals and not self._has_results, True
        for status in statuses:
            is_known = status.name in self._ends or (is_latched and status.name not in self._goals)
            self._ends[status.name] = None
            if is_known:
                continue
            reason, source = (status.values.get(key, "") for key in ("reason", "source"))
            words = f"goal {status.message}" + (f": {reason}" if reason else "") + (f" [{source}]" if source else "")
            level, elapsed = _LEVEL_OF_END.get(status.message, ERROR), number(status.values.get("elapsed time [s]"))
            found.append(Event(time, "end", level, words, status.name, elapsed))
        return found

    def of_region(self, time: float, region: float) -> list[Event]:
        """Return a switch of the law's region."""
        before, self._region = self._region, region
        if before is None or region == before or region not in (0.0, 1.0):
            return []
        return [Event(time, "switch", OK, f"region {REGION_NAMES[int(region)]}")]

    def of_diagnostics(self, time: float, statuses: list[Status]) -> list[Event]:
        """Return the nodes whose diagnosis has become an error, or another one."""
        found = []
        for status in statuses:
            if not self._is_own(status.name):
                continue
            parts = [part for part in status.message.split("; ") if part != "ok"]
            diagnosis = "; ".join(parts) if status.level == ERROR else ""
            if diagnosis and self._faults.get(status.name) != diagnosis:
                found.append(Event(time, "fault", ERROR, f"{_short(status.name)}: {diagnosis}"))
            self._faults[status.name] = diagnosis
        return found

    def of_log(self, time: float, line: LogLine) -> list[Event]:
        """Return a warning or error of /rosout."""
        if line.level < _WARNING_LINE or not self._is_own("/" + line.name.replace(".", "/")):
            return []
        return [Event(time, "fault", ERROR if line.level >= _ERROR_LINE else WARNING, f"{line.name}: {line.message}")]

    def _is_own(self, node: str) -> bool:
        return not self._namespace or node.startswith(self._namespace + "/")


def events_of(
    robot: RobotTables,
    curves: Mapping[str, Columns],
    goals: list[GoalSent],
    common: Mapping[str, list[Timed]],
    clock: Clock,
) -> list[Event]:
    """Return the events of a robot in the order of time."""
    maker = EventMaker(robot.namespace)
    driven = [goal for goal in goals if not goal.is_earlier]
    found = [maker.of_goal(goal.time, count, goal.pose) for count, goal in enumerate(driven, 1)]
    texts = robot.texts
    sources: list[tuple[list[Timed], Callable[[float, Any], list[Event]]]] = [
        (texts.get("controller", []), lambda time, status: maker.of_status(time, "controller", status)),
        (texts.get("filter", []), lambda time, status: maker.of_status(time, "filter", status)),
        (texts.get("results", []), maker.of_results),
        (common.get("/diagnostics", []), maker.of_diagnostics),
        (common.get("/rosout", []), maker.of_log),
    ]
    for messages, events_in in sources:
        for log_time, content in messages:
            found += events_in(clock.of_log_time(log_time), content)
    if "law" in curves:
        region = curves["law"]["region"]
        changes = np.flatnonzero(np.diff(region, prepend=np.nan) != 0.0)
        for index in changes.tolist():
            found += maker.of_region(float(curves["law"]["t"][index]), float(region[index]))
    found += _clock_jumps(robot, clock)
    found.sort(key=lambda event: event.time)
    numbers: Counter[str] = Counter()
    kept = []
    for event in found:
        numbers[event.kind] += 1
        if numbers[event.kind] <= MAX_EVENTS:
            kept.append(event)
    return kept


def _clock_jumps(robot: RobotTables, clock: Clock) -> list[Event]:
    """Return the topics whose stamps leapt for good against the times at which they were recorded."""
    found = []
    for role in ("odometry", "fixes"):
        if (table := robot.tables.get(role)) is None or len(table.stamps) < 2:
            continue
        order = np.argsort(table.log_times, kind="stable")
        ahead = (table.stamps - table.log_times)[order] * S_PER_NS
        at = int(np.argmax(np.abs(np.diff(ahead)))) + 1
        leap = float(np.median(ahead[at:]) - np.median(ahead[:at]))
        if min(abs(leap), abs(float(ahead[at] - ahead[at - 1]))) > _LEAP:
            time = clock.of_log_time(int(table.log_times[order[at]]))
            found.append(Event(time, "fault", WARNING, f"stamps of {role} jumped by {leap:+.1f} s"))
    return found


def _short(node: str) -> str:
    return node.rpartition("/")[2]
