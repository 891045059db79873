"""Does the filter know how wrong it is? Its innovations against what it expected of them, and what it refused."""

from __future__ import annotations

from collections import Counter, deque
from typing import NamedTuple

from scipy.special import chdtri

from diffbot_control.filter.gate import ACCEPTED, REJECTED, RELOCATED

WINDOW = 50
"""Accepted measurements that the mean is taken of."""
_ALARM = 1e-4
"""Probability of a false alarm, of one mean."""

KINDS = {3: "fixes", 2: "landmarks", 1: "headings"}
"""What a measurement of so many numbers is."""


class Nis(NamedTuple):
    """Mean NIS of accepted measurements per number measured; 1 if Q and R are right."""

    mean: float
    low: float
    """95 % of the means of a consistent filter are between these bounds"""
    high: float
    alarm: float
    """above it the covariances are too small for what is measured"""


class Consistency:
    """Running record of a filter."""

    def __init__(self) -> None:
        """Start with nothing recorded."""
        self.rejected: Counter[str] = Counter()
        self.relocated: Counter[str] = Counter()
        self._window: deque[tuple[float, int]] = deque(maxlen=WINDOW)

    def clear(self) -> None:
        """Forget the innovations; the counts stay."""
        self._window.clear()

    def note(self, size: int, nis: float, verdict: int) -> None:
        """Take in the verdict on a measurement of ``size`` numbers."""
        if verdict == REJECTED:
            self.rejected[KINDS[size]] += 1
        elif verdict == RELOCATED:
            self.relocated[KINDS[size]] += 1
            self._window.clear()  # they belong to a belief that was given up
        elif verdict == ACCEPTED:
            self._window.append((nis, size))

    def nis(self) -> Nis | None:
        """Return the mean over the window and its chi-square bounds; None before the first innovation."""
        if not self._window:
            return None
        numbers = sum(size for _, size in self._window)
        low, high, alarm = (float(chdtri(numbers, tail)) / numbers for tail in (0.975, 0.025, _ALARM))
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
