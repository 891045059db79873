"""What happened during a run, as a list: goals and their ends, states, switches of the region, rejections, faults."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np

from diffbot_control.law.regions import REGION_NAMES
from diffbot_core.geometry import MAX_COORDINATE, Pose, yaw_of_quaternion
from diffbot_lab.view.bag_tables import RobotTables, Timed
from diffbot_lab.view.signals import Clock, Columns

OK, WARNING, ERROR = 0, 1, 2
MAX_EVENTS = 2000
"""that are kept of a robot; the later ones are left out"""
_STATUS_DELAY = 2.0
"""[s] between a goal and the status that names it"""
_LEVEL_OF_END = {"reached": OK, "cancelled": OK, "replaced": OK}
_WARNING_LINE, _ERROR_LINE = 30, 40
_COUNTED = (" rejected", "relocations by ")


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
    """Return the goals, from goal_pose and from the controller's status, which also knows those of a service."""
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
        # The status of the goal before may come a moment after the next one's message.
        near = [one for one in found[index:] if one.time <= time + _STATUS_DELAY]
        if not any(_same(one.pose, pose) for one in (*found[max(index - 1, 0) : index], *near)):
            found.insert(index, GoalSent(time, pose))
    return found


def goal_in(values: Mapping[str, str]) -> Pose | None:
    """Return the goal among the values of controller/status, None if there is none."""
    try:
        x, y, theta = map(float, values.get("goal", "").split())
    except ValueError:
        return None
    return Pose(x, y, theta) if np.isfinite([x, y, theta]).all() else None


def _same(a: Pose, b: Pose) -> bool:
    return all(abs(p - q) <= 1e-4 * max(1.0, abs(p)) for p, q in zip(a, b, strict=True))


def events_of(
    robot: RobotTables,
    curves: Mapping[str, Columns],
    goals: list[GoalSent],
    common: Mapping[str, list[Timed]],
    clock: Clock,
) -> list[Event]:
    """Return the events of a robot in the order of time."""
    found = [
        Event(time, "goal", OK, f"goal {number}: x {x:.2f} m, y {y:.2f} m, {np.degrees(theta):.0f} deg")
        for number, (time, (x, y, theta)) in enumerate(goals, 1)
    ]
    for who in ("controller", "filter"):
        found += _states(robot.texts.get(who, []), clock)
        found += _counts(robot.texts.get(who, []), clock)
    found += _ends(robot.texts.get("results", []), clock)
    if "law" in curves:
        found += _switches(curves["law"])
    found += _faults(common.get("/diagnostics", []), robot.namespace, clock)
    found += _log_lines(common.get("/rosout", []), robot.namespace, clock)
    found.sort(key=lambda event: event.time)
    return found[:MAX_EVENTS]


def _states(statuses: list[Timed], clock: Clock) -> Iterator[Event]:
    before = ""
    for log_time, status in statuses:
        if status.message != before:
            reason = status.values.get("reason", "")
            text = f"{_short(status.name)}: {status.message}" + (f" ({reason})" if reason else "")
            yield Event(clock.of_log_time(log_time), "state", min(status.level, ERROR), text)
        before = status.message


def _counts(statuses: list[Timed], clock: Clock) -> Iterator[Event]:
    """Yield an event when one of the filter's counters has grown."""
    last: dict[str, int] = {}
    for log_time, status in statuses:
        for key, value in status.values.items():
            if not (key.endswith(_COUNTED[0]) or key.startswith(_COUNTED[1])) or not value.isdigit():
                continue
            count = int(value[:15])
            if (more := count - last.get(key, 0)) > 0:
                kind = "relocation" if key.startswith(_COUNTED[1]) else "rejection"
                yield Event(clock.of_log_time(log_time), kind, WARNING, f"{key}: {more} more, {count} in all")
            last[key] = count


def _ends(results: list[Timed], clock: Clock) -> Iterator[Event]:
    known: set[str] = set()
    for log_time, statuses in results:
        for status in statuses:
            if status.name not in known:
                known.add(status.name)
                reason, source = (status.values.get(key, "") for key in ("reason", "source"))
                words = (
                    f"goal {status.message}" + (f": {reason}" if reason else "") + (f" [{source}]" if source else "")
                )
                yield Event(clock.of_log_time(log_time), "end", _LEVEL_OF_END.get(status.message, ERROR), words)


def _switches(law: Columns) -> Iterator[Event]:
    region = law["region"]
    for index in (np.flatnonzero(np.diff(region)) + 1).tolist():
        if region[index] in (0.0, 1.0):
            yield Event(float(law["t"][index]), "switch", OK, f"region {REGION_NAMES[int(region[index])]}")


def _faults(diagnostics: list[Timed], namespace: str, clock: Clock) -> Iterator[Event]:
    """Yield an event when a node's diagnosis becomes an error, or another one."""
    last: dict[str, str] = {}
    for log_time, statuses in diagnostics:
        for status in statuses:
            if not _is_of(status.name, namespace):
                continue
            diagnosis = status.message if status.level >= ERROR else ""
            if diagnosis and last.get(status.name) != diagnosis:
                yield Event(clock.of_log_time(log_time), "fault", ERROR, f"{_short(status.name)}: {diagnosis}")
            last[status.name] = diagnosis


def _log_lines(lines: list[Timed], namespace: str, clock: Clock) -> Iterator[Event]:
    for log_time, line in lines:
        if line.level >= _WARNING_LINE and _is_of("/" + line.name.replace(".", "/"), namespace):
            level = ERROR if line.level >= _ERROR_LINE else WARNING
            yield Event(clock.of_log_time(log_time), "fault", level, f"{line.name}: {line.message}")


def _is_of(node: str, namespace: str) -> bool:
    return not namespace or node.startswith(namespace + "/")


def _short(node: str) -> str:
    return node.rpartition("/")[2]
