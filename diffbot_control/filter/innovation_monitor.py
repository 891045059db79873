"""Consistency of the filter: its innovations against their expected covariance, and how many were rejected."""

from __future__ import annotations

from collections import Counter, deque
from typing import NamedTuple

from scipy.special import chdtri

from diffbot_control.filter.gate import ACCEPTED, FIX, HEADING, LANDMARK, REJECTED, RELOCATED

WINDOW = 50
"""Number of accepted measurements in the mean."""
_FALSE_ALARM = 1e-4
"""Probability that the mean of a consistent filter exceeds the alarm bound."""

KINDS = {FIX: "fixes", LANDMARK: "landmarks", HEADING: "headings"}
"""Names of the kinds of measurement."""
_NUMBERS = {FIX: 3, LANDMARK: 2, HEADING: 1}
"""Numbers measured by each kind."""


class Nis(NamedTuple):
    """Mean NIS of accepted measurements per number measured; 1 if Q and R are right."""

    mean: float
    low: float
    """95 % of the means of a consistent filter are between these bounds"""
    high: float
    alarm: float
    """above it the covariances are too small for the innovations"""


class InnovationMonitor:
    """Record of a filter's innovations."""

    def __init__(self) -> None:
        """Start with an empty record."""
        self.rejected: Counter[str] = Counter()
        self.relocated: Counter[str] = Counter()
        self._window: deque[tuple[float, int]] = deque(maxlen=WINDOW)

    def clear(self) -> None:
        """Clear the innovations; the counters stay."""
        self._window.clear()

    def record(self, kind: int, nis: float, outcome: int) -> None:
        """Add a measurement: its kind (FIX, LANDMARK or HEADING), its NIS and the outcome of the gate's decision."""
        if outcome == ACCEPTED:
            self._window.append((nis, kind))
        elif outcome == REJECTED:
            self.rejected[KINDS[kind]] += 1
        elif outcome == RELOCATED:
            self.relocated[KINDS[kind]] += 1
            self._window.clear()  # those innovations belong to the estimate that was given up

    def nis(self) -> Nis | None:
        """Return the mean over the window and its chi-square bounds; None if the window is empty."""
        if not self._window:
            return None
        numbers = sum(_NUMBERS[kind] for _, kind in self._window)
        low, high, alarm = (float(chdtri(numbers, tail)) / numbers for tail in (0.975, 0.025, _FALSE_ALARM))
        return Nis(sum(nis for nis, _ in self._window) / numbers, low, high, alarm)

    def values(self) -> dict[str, str]:
        """Return key-value pairs for a diagnostic status."""
        values = {}
        nis = self.nis()
        if nis is not None:
            values["NIS per number"] = f"{nis.mean:.3f}"
            values["NIS 95 % bounds"] = f"{nis.low:.3f} {nis.high:.3f}"
        for kind in KINDS.values():
            if self.rejected[kind] or self.relocated[kind] or kind == "fixes":
                values[f"{kind} rejected"] = str(self.rejected[kind])
                values[f"relocations by {kind}"] = str(self.relocated[kind])
        return values
