"""Reads diagnostic messages: states, ends of goals and diagnoses.

A message has the attributes of its ROS type. It comes from rclpy or from a decoded bag.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple, TypeVar

OK, WARNING, ERROR = 0, 1, 2
"""Levels of a DiagnosticStatus, which events and lines of text use, too."""
MAX_TEXT = 300
"""Largest number of characters of a text. Longer texts are cut."""
K = TypeVar("K")
V = TypeVar("V")


class Status(NamedTuple):
    """A diagnostic_msgs/DiagnosticStatus."""

    level: int
    """0 to 3: ok, warning, error, stale"""
    name: str
    message: str
    values: Mapping[str, str]


class BoundedTable(dict[K, V]):
    """A dict of limited size, which drops the entry that was set least recently, and counts the dropped entries.

    Without a limit, keys from received messages could fill the memory.
    """

    def __init__(self, size: int) -> None:
        """Start empty; ``size`` is the largest number of entries."""
        super().__init__()
        self._size = size
        self.dropped = 0

    def __setitem__(self, key: K, value: V) -> None:
        """Set an entry, which becomes the newest."""
        self.pop(key, None)
        super().__setitem__(key, value)
        if len(self) > self._size:
            del self[next(iter(self))]
            self.dropped += 1


def status_of(message: Any) -> Status:
    """Return the contents of a DiagnosticStatus; its texts are cut to MAX_TEXT characters."""
    values = {cut(one.key): cut(one.value) for one in message.values}
    # A field of type byte is bytes of length 1 in rclpy.
    level = message.level[0] if isinstance(message.level, bytes) else message.level
    return Status(level, cut(message.name), cut(message.message), values)


def statuses_of(message: Any) -> list[Status]:
    """Return the contents of a DiagnosticArray."""
    return [status_of(one) for one in message.status]


def filter_numbers(values: Mapping[str, str]) -> tuple[float, ...]:
    """Return a row of columns.FILTER_COLUMNS from the values of ekf/status; a missing value is NaN."""
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


def number(text: str | None) -> float:
    """Return the number at the beginning of a text; NaN if the text does not begin with a number."""
    try:
        return float((text or "").split()[0])
    except (IndexError, ValueError):
        return math.nan


def cut(text: str) -> str:
    """Return a text, cut to MAX_TEXT characters."""
    return text if len(text) <= MAX_TEXT else text[: MAX_TEXT - 3] + "..."
