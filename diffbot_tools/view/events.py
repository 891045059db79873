"""The events of a robot: goals and their ends, states, switches of the region, rejected measurements and faults."""

from __future__ import annotations

from math import degrees
from typing import NamedTuple

from diffbot_control.goals.record import end_text
from diffbot_control.law.regions import REGION_NAMES
from diffbot_core.geometry import Pose
from diffbot_tools.view.goal_list import Goal
from diffbot_tools.view.texts import ERROR, OK, WARNING, BoundedTable, Status, cut

MAX_NAMES = 1000
"""Largest number of nodes, and of counters, whose last value is kept."""
_LEVEL_OF_END = {"reached": OK, "cancelled": OK, "replaced": OK}
_WARNING_LINE, _ERROR_LINE = 30, 40
"""Levels of a rcl_interfaces/Log."""
_LEAP, _CONFIRMED = 1.0, 5
"""[s] Smallest jump of stamps, and number of consecutive messages that confirm it, since one message can be late."""


class Event(NamedTuple):
    """One line of the list of events. The page receives the fields in this order."""

    time: float
    """[s]"""
    kind: str
    """goal, end, state, switch, rejection, relocation, fault"""
    level: int
    text: str


def goal_event(goal: Goal, count: int, is_docking: bool = False) -> Event:
    """Return the event of a new goal, which is goal number ``count`` of its controller."""
    x, y, theta = goal.pose
    text = f"goal {count}: x {x:.2f} m, y {y:.2f} m, {round(degrees(theta))} deg"
    return Event(goal.time, "goal", OK, f"{docking_verb(goal.pose)}: accepted" if is_docking else text)


def end_event(time: float, end: str, reason: str, source: str, subject: str = "goal") -> Event:
    """Return the event of the end of a goal; the text begins with ``subject``, such as ``goal`` or ``dock:``."""
    text = f"{subject} {end_text(end, reason)}" + (f" [{source}]" if source else "")
    return Event(time, "end", _LEVEL_OF_END.get(end, ERROR), text)


def docking_verb(goal: Pose) -> str:
    """Return ``dock`` or ``undock`` for a goal in the frame of the dock, whose origin is the pose of a docked robot."""
    return "dock" if goal == Pose(0.0, 0.0, 0.0) else "undock"


class EventMaker:
    """Compares each message with the previous one and returns the events between them."""

    def __init__(self, namespace: str = "") -> None:
        """Start without messages.

        Args:
            namespace: such as ``/robot1``; nodes of other namespaces in /diagnostics and /rosout are ignored.
        """
        self._namespace = namespace
        self._states: dict[str, str] = {}
        self._counts: BoundedTable[str, int] = BoundedTable(MAX_NAMES)
        self._faults: BoundedTable[str, str] = BoundedTable(MAX_NAMES)
        self._region: float | None = None
        self._ahead: dict[str, tuple[float, int]] = {}
        """usual stamp minus reception [s] of each role, and number of consecutive messages that differ from it"""

    def of_status(self, time: float, status: Status) -> list[Event]:
        """Return the events of a ~/status: a new state, and increased counters of the filter."""
        found = []
        if status.message != self._states.get(status.name, ""):
            reason = status.values.get("reason", "")
            text = f"{_short(status.name)}: {status.message}" + (f" ({reason})" if reason else "")
            found.append(Event(time, "state", min(status.level, ERROR), text))
        self._states[status.name] = status.message
        for key, value in status.values.items():
            is_relocation = key.startswith("relocations by ")
            if not (is_relocation or key.endswith(" rejected")) or not value.isdecimal():
                continue
            count, name = int(value[:15]), f"{status.name} {key}"
            if (more := count - self._counts.get(name, 0)) > 0:
                kind = "relocation" if is_relocation else "rejection"
                words = key.replace("relocations", "filter relocated") if is_relocation else f"{key}: {more} more"
                found.append(Event(time, kind, WARNING, f"{words}, {count} in all"))
            self._counts[name] = count
        return found

    def of_region(self, time: float, region: float) -> list[Event]:
        """Return an event if the region of the law has changed."""
        before, self._region = self._region, region
        if before is None or region == before or region not in (0.0, 1.0):
            return []
        return [Event(time, "switch", OK, f"region {REGION_NAMES[int(region)]}")]

    def of_diagnostics(self, time: float, statuses: list[Status]) -> list[Event]:
        """Return an event for each node that reports a new error."""
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

    def of_log(self, time: float, level: int, name: str, text: str) -> list[Event]:
        """Return an event for a line of /rosout if the line is a warning or an error."""
        if level < _WARNING_LINE or not self._is_own("/" + name.replace(".", "/")):
            return []
        return [Event(time, "fault", ERROR if level >= _ERROR_LINE else WARNING, f"{cut(name)}: {cut(text)}")]

    def of_stamp(self, role: str, stamp: float, received: float) -> list[Event]:
        """Return an event if the stamps [s] of a topic have jumped with respect to the times of reception [s]."""
        ahead = stamp - received
        usual, count = self._ahead.get(role, (ahead, 0))
        if abs(ahead - usual) <= _LEAP:
            self._ahead[role] = usual, 0
            return []
        self._ahead[role] = usual, count + 1
        if count + 1 < _CONFIRMED:
            return []
        self._ahead[role] = ahead, 0
        return [Event(received, "fault", WARNING, f"stamps of {role} jumped by {ahead - usual:+.1f} s")]

    def _is_own(self, node: str) -> bool:
        return not self._namespace or node.startswith(self._namespace + "/")


def _short(node: str) -> str:
    return node.rpartition("/")[2]
