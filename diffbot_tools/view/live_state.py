"""The newest state of all robots. The thread of ROS writes it, and the thread of the server reads it."""

from __future__ import annotations

import math
import threading
from array import array
from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from diffbot_tools.view.columns import COLUMNS
from diffbot_tools.view.events import Event

EVENTS, HISTORY = 500, 6000
"""Number of events of a robot, and of rows of a curve (ten minutes at 10 Hz), that a new browser receives."""
_HISTORY_PERIOD = 0.1 - 1e-6
"""[s] Shortest time between two rows of the history, with a margin for the rounding of times."""

Key = tuple[str, str, str]
"""Robot (empty for all robots), group (``rows`` or empty) and name."""


class Changes(NamedTuple):
    """The changes since a version of the state."""

    state: dict[str, Any]
    """message ``state`` for the page; empty if nothing has changed"""
    events: dict[str, list[Event]]
    """by robot"""
    version: int
    """the newest version"""


class LiveState:
    """The newest state of all robots. All methods are thread-safe and return at once."""

    def __init__(self, robots: Sequence[str]) -> None:
        """Start empty."""
        self.robots = tuple(robots)
        self._lock = threading.Lock()
        self._version = 0
        self._newest: dict[Key, tuple[int, Any]] = {}
        self._events: dict[str, deque[tuple[int, Event]]] = {robot: deque(maxlen=EVENTS) for robot in robots}
        self._history: dict[tuple[str, str], deque[array[float]]] = {
            (robot, curve): deque(maxlen=HISTORY) for robot in robots for curve in COLUMNS
        }

    def put_row(self, robot: str, curve: str, row: Sequence[float]) -> None:
        """Set the newest row of a curve, in the order of COLUMNS; numbers that are not finite become None."""
        numbers = _finite(row)
        with self._lock:
            self._set((robot, "rows", curve), numbers)
            history = self._history[robot, curve]
            if history and row[0] < history[-1][0]:
                history.clear()  # time has jumped back: a new run
            if math.isfinite(row[0]) and (not history or row[0] - history[-1][0] >= _HISTORY_PERIOD):
                history.append(array("d", row))  # needs a quarter of the memory of a list

    def put(self, robot: str, name: str, value: Any) -> None:
        """Set a named value, which JSON can represent, of a robot; if ``robot`` is empty, of all robots together."""
        with self._lock:
            if (before := self._newest.get((robot, "", name))) is None or before[1] != value:
                self._set((robot, "", name), value)

    def _set(self, key: Key, value: Any) -> None:
        self._version += 1
        self._newest[key] = self._version, value

    def add_events(self, robot: str, events: Sequence[Event]) -> None:
        """Append events of a robot."""
        with self._lock:
            for event in events:
                self._version += 1
                self._events[robot].append((self._version, event))

    def history(self) -> list[dict[str, Any]]:
        """Return the rows so far as messages for the page, one message for each curve."""
        with self._lock:
            found = {key: list(rows) for key, rows in self._history.items() if rows}
        return [
            {"type": "history", "robot": robot, "curve": curve, "rows": [_finite(row) for row in rows]}
            for (robot, curve), rows in found.items()
        ]

    def changes_since(self, version: int) -> Changes:
        """Return all values and events that are newer than ``version``; version 0 is older than all."""
        with self._lock:
            changed = {key: value for key, (since, value) in self._newest.items() if since > version}
            events = {
                robot: [event for since, event in many if since > version]
                for robot, many in self._events.items()
                if many and many[-1][0] > version
            }
            return Changes(_message(changed), events, self._version)


class RobotSink:
    """Writes the results of the model of one robot to the live state."""

    def __init__(self, state: LiveState, name: str) -> None:
        """Write to ``state`` under the robot's ``name``."""
        self._state, self._name = state, name

    def row(self, curve: str, values: Sequence[float]) -> None:
        """Set the newest row of a curve."""
        self._state.put_row(self._name, curve, values)

    def events(self, events: Sequence[Event]) -> None:
        """Append events."""
        self._state.add_events(self._name, events)

    def put(self, name: str, value: Any) -> None:
        """Set a new value."""
        self._state.put(self._name, name, value)


def _finite(row: Sequence[float]) -> list[float | None]:
    return [number if math.isfinite(number) else None for number in row]


def _message(changed: Mapping[Key, Any]) -> dict[str, Any]:
    if not changed:
        return {}
    robots: dict[str, dict[str, Any]] = {}
    message: dict[str, Any] = {"type": "state", "robots": robots}
    for (robot, group, name), value in changed.items():
        place = robots.setdefault(robot, {}) if robot else message
        (place.setdefault(group, {}) if group else place)[name] = value
    return message
