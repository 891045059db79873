"""Consistency of a filter as the topics of a bag show it: mean NIS and autocorrelations against their bounds."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Protocol

from diffbot_bag.bag.number_rows import LABELLED, NumberRows, labelled_layout, labels_of
from diffbot_bag.tools.contract_check import Consistency
from diffbot_control.filter.innovation_monitor import WINDOW, mean_nis
from diffbot_core.cdr import CdrError
from diffbot_tools.refilter.nis_topic import NIS_LABELS, NIS_TOPIC
from diffbot_tools.view.robot_topics import STATUS
from diffbot_tools.view.texts import number, read_status

_MAX_NUMBERS = 3
"""of a measurement"""
_NIS, _BOUNDS = "NIS per number", "NIS 95 % bounds"
_CORRELATION, _BOUND = "autocorrelation of ", ", 95 % bound"


class Observer(Protocol):
    """Takes the messages of a topic."""

    def add(self, log_time: int, data: bytes) -> None:
        """Take a message."""

    def result(self) -> Consistency:
        """Return what the messages so far show."""


class StatusObserver:
    """Reads ``ekf/status``: each message has a mean NIS, autocorrelations, and the 95 % bounds of both."""

    def __init__(self) -> None:
        """Start without messages."""
        self._nis, self._white = _Share(), _Share()

    def add(self, _log_time: int, data: bytes) -> None:
        """Take a message; one that is no DiagnosticStatus shows nothing."""
        try:
            values = read_status(data).values
        except CdrError:
            return
        low, _, high = values.get(_BOUNDS, "").partition(" ")
        self._nis.note(number(values.get(_NIS)), number(low), number(high))
        for key, value in values.items():
            if key.startswith(_CORRELATION) and not key.endswith(_BOUND):
                bound = number(values.get(key + _BOUND))
                self._white.note(number(value), -bound, bound)

    def result(self) -> Consistency:
        """Return the shares within the bounds."""
        return Consistency(self._nis.value(), self._white.value())


class NisObserver:
    """Reads ``ekf/nis`` of a bag that was filtered again: one message per measurement."""

    def __init__(self) -> None:
        """Start without messages."""
        self._rows = NumberRows(labelled_layout(NIS_LABELS), range(len(NIS_LABELS)))

    def add(self, log_time: int, data: bytes) -> None:
        """Take a message; one with other labels shows nothing."""
        try:
            if tuple(labels_of(data)) == NIS_LABELS:
                self._rows.add(log_time, data)
        except CdrError:
            return

    def result(self) -> Consistency:
        """Return the share of the windows whose mean NIS is within its bounds; innovations are not in the bag."""
        rows = self._rows.columns()[2].tolist()
        used = [(nis, int(numbers)) for nis, numbers, accepted in rows if accepted and 1 <= numbers <= _MAX_NUMBERS]
        share = _Share()
        # Windows that do not overlap.
        for first in range(0, len(used) - WINDOW + 1, WINDOW):
            if (mean := mean_nis(used[first : first + WINDOW])) is not None:
                share.note(mean.mean, mean.low, mean.high)
        return Consistency(nis_inside=share.value())


class _Share:
    """Counts numbers between their bounds."""

    def __init__(self) -> None:
        self._inside = self._all = 0

    def note(self, value: float, low: float, high: float) -> None:
        if not math.isnan(value) and low <= high:
            self._all += 1
            self._inside += low <= value <= high

    def value(self) -> float | None:
        return self._inside / self._all if self._all else None


def observers_for(types: Mapping[str, str]) -> dict[str, Observer]:
    """Return an observer for each topic that can show consistency.

    Args:
        types: of the topics, by name.
    """
    found: dict[str, Observer] = {}
    for name, kind in types.items():
        if kind == STATUS:
            found[name] = StatusObserver()
        elif kind == LABELLED and name.endswith(NIS_TOPIC):
            found[name] = NisObserver()
    return found
