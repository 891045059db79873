"""The messages of a bag that consist of texts: states, ends of goals, diagnostics and logs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

from diffbot_core.cdr import CdrCursor

FILTER_COLUMNS = ("nis", "nis_low", "nis_high", "whiteness", "whiteness_bound", "left", "right")
"""Mean NIS per number and its 95 % bounds, autocorrelation of the first kind of measurement, wheel radius errors."""
MAX_TEXT = 300
"""characters that are kept of one text"""


class Status(NamedTuple):
    """A diagnostic_msgs/DiagnosticStatus."""

    level: int
    """0 to 3: ok, warning, error, stale"""
    name: str
    message: str
    values: Mapping[str, str]


class LogLine(NamedTuple):
    """A rcl_interfaces/Log."""

    stamp: int
    """[ns]"""
    level: int
    """10, 20, 30, 40, 50: debug to fatal"""
    name: str
    message: str


def read_status(data: bytes) -> Status:
    """Read a DiagnosticStatus.

    Raises:
        CdrError: if it is none.
    """
    return _status(CdrCursor(data))


def read_statuses(data: bytes) -> list[Status]:
    """Read a DiagnosticArray.

    Raises:
        CdrError: if it is none.
    """
    cursor = CdrCursor(data)
    cursor.stamp()
    cursor.text()
    return [_status(cursor) for _ in range(cursor.length())]


def read_log(data: bytes) -> LogLine:
    """Read a line of /rosout.

    Raises:
        CdrError: if it is none.
    """
    cursor = CdrCursor(data)
    return LogLine(cursor.stamp(), cursor.byte(), _cut(cursor.text()), _cut(cursor.text()))


def filter_numbers(values: Mapping[str, str]) -> tuple[float, ...]:
    """Return FILTER_COLUMNS from the values of ekf/status; NaN for what is not in them."""
    bounds = values.get("NIS 95 % bounds", "").split()
    kinds = [key for key in values if key.startswith("autocorrelation of ") and not key.endswith(" bound")]
    kind = kinds[0] if kinds else ""
    return (
        number(values.get("NIS per number")),
        *(number(bounds[index] if len(bounds) == 2 else None) for index in (0, 1)),
        number(values.get(kind)),
        number(values.get(f"{kind}, 95 % bound")),
        *(number(values.get(f"{side} wheel radius error")) for side in ("left", "right")),
    )


def controller_state(status: Status) -> dict[str, Any]:
    """Return what the page puts into words of a controller's status (page/words.js)."""
    values = status.values
    return {
        "text": status.message,
        "level": status.level,
        "reason": values.get("reason", ""),
        "finish": values.get("finish", ""),
        "waypoint": values.get("waypoint", ""),
        "isHeld": "goal" in values,
    }


def docking_state(status: Status) -> tuple[int, str] | None:
    """Return level and text of a docking under way; None without one."""
    values = status.values
    if "goal" not in values:
        return None
    if status.message != "driving":
        return status.level, f"docking: {status.message}"
    broken_off = values.get("approaches broken off", "0")
    text = f"docking: {values.get('phase', 'driving')}"
    return (0, text) if broken_off == "0" else (1, f"{text}, approaches broken off: {broken_off}")


def filter_state(status: Status) -> dict[str, Any]:
    """Return what the page puts into words of the filter's status: why it gives no poses; empty if it does."""
    return {"filter": status.values.get("reason", status.message) if status.level else ""}


def number(text: str | None) -> float:
    """Return the first number of a text, NaN if it does not begin with one."""
    try:
        return float((text or "").split()[0])
    except (IndexError, ValueError):
        return math.nan


def _status(cursor: CdrCursor) -> Status:
    level, name, message = cursor.byte(), cursor.text(), cursor.text()
    cursor.text()
    values = {}
    for _ in range(cursor.length()):
        key = cursor.text()
        values[_cut(key)] = _cut(cursor.text())
    return Status(level, _cut(name), _cut(message), values)


def _cut(text: str) -> str:
    return text if len(text) <= MAX_TEXT else text[: MAX_TEXT - 3] + "..."
