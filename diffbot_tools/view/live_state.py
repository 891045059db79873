"""The newest state of all robots, handed from the thread of ROS to that of the server: old news is never queued."""

from __future__ import annotations

import math
import threading
from array import array
from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from diffbot_tools.view.events import Event
from diffbot_tools.view.texts import FILTER_COLUMNS

COLUMNS: dict[str, tuple[str, ...]] = {
    "estimate": ("t", "x", "y", "theta", "xx", "xy", "yy", "tt"),
    "truth": ("t", "x", "y", "theta", "v", "omega"),
    "odometry": ("t", "x", "y", "theta", "v", "omega"),
    "fixes": ("t", "x", "y", "theta"),
    "command": ("t", "v", "omega"),
    "law": ("t", "rho", "alpha", "beta", "eps_P", "region", "V"),
    "filter": ("t", *FILTER_COLUMNS),
}
"""Columns of each live curve, by its name."""
EVENTS, HISTORY = 500, 6000
"""Number of events, and of rows of each curve, that a browser gets when it connects: ten minutes at 10 Hz."""
_HISTORY_PERIOD = 0.1 - 1e-6
"""[s]; the margin is for the rounding of times"""

Key = tuple[str, str, str]
"""Robot, group (``rows`` or empty), name; the robot is empty for what concerns all."""


class News(NamedTuple):
    """What has changed since a browser asked last."""

    state: dict[str, Any]
    """message ``state`` for the page; empty if nothing has changed"""
    events: dict[str, list[Event]]
    """by robot"""
    version: int
    """to ask with the next time"""


class LiveState:
    """Thread-safe; every method returns at once."""

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
        """Set the newest row of a curve, in the order of COLUMNS; numbers that are not finite count as missing."""
        numbers = _finite(row)
        with self._lock:
            self._set((robot, "rows", curve), numbers)
            history = self._history[robot, curve]
            if history and row[0] < history[-1][0]:
                history.clear()  # time has jumped back: a new run
            if math.isfinite(row[0]) and (not history or row[0] - history[-1][0] >= _HISTORY_PERIOD):
                history.append(array("d", row))  # a quarter of the memory of a list

    def put(self, robot: str, name: str, value: Any) -> None:
        """Set something else that concerns a robot, or all with an empty ``robot``, as JSON takes it."""
        with self._lock:
            if (before := self._newest.get((robot, "", name))) is None or before[1] != value:
                self._set((robot, "", name), value)

    def _set(self, key: Key, value: Any) -> None:
        self._version += 1
        self._newest[key] = self._version, value

    def add_events(self, robot: str, events: Sequence[Event]) -> None:
        """Append to the list of events."""
        with self._lock:
            for event in events:
                self._version += 1
                self._events[robot].append((self._version, event))

    def history(self) -> list[dict[str, Any]]:
        """Return the curves so far as messages for the page."""
        with self._lock:
            found = {key: list(rows) for key, rows in self._history.items() if rows}
        return [
            {"type": "history", "robot": robot, "curve": curve, "rows": [_finite(row) for row in rows]}
            for (robot, curve), rows in found.items()
        ]

    def news(self, version: int) -> News:
        """Return what is newer than ``version``; 0 for everything."""
        with self._lock:
            changed = {key: value for key, (since, value) in self._newest.items() if since > version}
            events = {
                robot: [event for since, event in many if since > version]
                for robot, many in self._events.items()
                if many and many[-1][0] > version
            }
            return News(_message(changed), events, self._version)


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
