"""What happened during a run, as a list: goals and their ends, states, switches of the region, rejections, faults."""

from __future__ import annotations

from bisect import bisect_right
from collections import Counter
from collections.abc import Callable, Mapping
from math import degrees
from typing import Any, NamedTuple

import numpy as np

from diffbot_control.law.regions import REGION_NAMES
from diffbot_core.geometry import MAX_COORDINATE, Pose, yaw_of_quaternion
from diffbot_core.units import S_PER_NS
from diffbot_tools.view.bag_tables import RobotTables, Timed
from diffbot_tools.view.bounded_table import BoundedTable
from diffbot_tools.view.clock import Clock, Columns
from diffbot_tools.view.texts import LogLine, Status

OK, WARNING, ERROR = 0, 1, 2
MAX_GOALS = 2000
"""of a robot that are shown; later ones are left out"""
MAX_EVENTS = 10_000
"""of a kind that are kept of a robot; later ones are left out"""
MAX_NAMES = 1000
"""of nodes, goals and counters whose last message is remembered"""
_STATUS_DELAY = 2.0
"""[s] between a goal and the status that names it"""
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


class GoalSent(NamedTuple):
    """A goal pose and when it was received."""

    time: float
    """[s]"""
    pose: Pose


def goals_of(robot: RobotTables, clock: Clock) -> list[GoalSent]:
    """Return the goals, from goal_pose and from the controller's status, which also knows those of a service.

    A goal that was corrected has its last pose.
    """
    found = []
    if (table := robot.tables.get("goals")) is not None:
        for stamp, log_time, row in zip(table.stamps.tolist(), table.log_times.tolist(), table.numbers, strict=True):
            x, y, qx, qy, qz, qw = row.tolist()
            yaw = yaw_of_quaternion(qx, qy, qz, qw)
            # A goal from a command line has no stamp.
            time = (stamp - clock.origin) * 1e-9 if stamp >= clock.origin else clock.of_log_time(log_time)
            if np.isfinite([x, y, yaw]).all() and max(abs(x), abs(y)) <= MAX_COORDINATE:
                found.append(GoalSent(time, Pose(x, y, yaw)))
    found.sort(key=lambda one: one.time)
    for log_time, status in robot.texts.get("controller", []):
        pose, time = goal_in(status.values), clock.of_log_time(log_time)
        if pose is None:
            continue
        index = bisect_right(found, time, key=lambda one: one.time)
        if is_corrected(status.values):
            if index and found[index - 1].time < time - _STATUS_DELAY:
                found[index - 1] = found[index - 1]._replace(pose=pose)
            continue
        # A status may name the goal before a moment after the next one's message, or the next one before it.
        first = index - 1 - (index > 1 and found[index - 1].time >= time - _STATUS_DELAY)
        near = [one for one in found[index:] if one.time <= time + _STATUS_DELAY]
        if not any(_same(one.pose, pose) for one in (*found[max(first, 0) : index], *near)):
            found.insert(index, GoalSent(time, pose))
    return found[:MAX_GOALS]


def goal_in(values: Mapping[str, str]) -> Pose | None:
    """Return the goal among the values of controller/status, None if there is none."""
    try:
        x, y, theta = map(float, values.get("goal", "").split())
    except ValueError:
        return None
    return Pose(x, y, theta) if np.isfinite([x, y, theta]).all() else None


def is_corrected(values: Mapping[str, str]) -> bool:
    """Whether the goal in controller/status is an earlier one that was corrected since."""
    return "goal updates" in values


def _same(a: Pose, b: Pose) -> bool:
    return all(abs(p - q) <= 1e-4 * max(1.0, abs(p)) for p, q in zip(a, b, strict=True))


class EventMaker:
    """Turns the messages of one robot, in the order of time, into events: for a bag as for a live robot."""

    def __init__(self, namespace: str = "") -> None:
        """Keep of /diagnostics and /rosout what comes from nodes in ``namespace``, such as ``/robot1``."""
        self._namespace = namespace
        self._states: dict[str, str] = {}
        self._counts: BoundedTable[str, int] = BoundedTable(MAX_NAMES)
        self._ends: BoundedTable[str, None] = BoundedTable(MAX_NAMES)
        self._faults: BoundedTable[str, str] = BoundedTable(MAX_NAMES)
        self._region: float | None = None

    def of_goal(self, time: float, number: int, pose: Pose) -> Event:
        """Return the event of a new goal."""
        return Event(
            time, "goal", OK, f"goal {number}: x {pose.x:.2f} m, y {pose.y:.2f} m, {degrees(pose.theta):.0f} deg"
        )

    def of_status(self, time: float, who: str, status: Status) -> list[Event]:
        """Return the events of a ~/status: a new state, and counters of the filter that have grown."""
        found = []
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

    def of_results(self, time: float, statuses: list[Status]) -> list[Event]:
        """Return the ends of goals that are new in ~/goal_results."""
        found = []
        for status in statuses:
            is_known = status.name in self._ends
            self._ends[status.name] = None
            if is_known:
                continue
            reason, source = (status.values.get(key, "") for key in ("reason", "source"))
            words = f"goal {status.message}" + (f": {reason}" if reason else "") + (f" [{source}]" if source else "")
            found.append(Event(time, "end", _LEVEL_OF_END.get(status.message, ERROR), words))
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
    found = [maker.of_goal(time, number, pose) for number, (time, pose) in enumerate(goals, 1)]
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
