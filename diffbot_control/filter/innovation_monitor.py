"""Consistency of the filter: its innovations against their expected covariance, and how many were rejected.

Innovations of a right model are white. Their autocorrelation shows what the NIS does not: fixes whose errors last
longer than the time between them look harmless one by one, and make the filter far too sure.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Hashable, Iterable, Sequence
from typing import NamedTuple

import numpy as np

from diffbot_control.filter.chi_square import chi_square_bound
from diffbot_control.filter.gate import ACCEPTED, FIX, HEADING, LANDMARK, REJECTED, RELOCATED, WEIGHED
from diffbot_control.filter.measurements import Array

WINDOW = 50
"""Number of accepted measurements in the mean."""
_FALSE_ALARM = 1e-4
"""Probability that the mean of a consistent filter exceeds the alarm bound."""

KINDS = {FIX: "fixes", LANDMARK: "landmarks", HEADING: "headings"}
"""Names of the kinds of measurement."""
_NUMBERS = {FIX: 3, LANDMARK: 2, HEADING: 1}
"""Numbers measured by each kind, if nothing else is known."""
_WHITENESS_WINDOW = 100
"""Number of accepted measurements of a kind in the autocorrelation."""
_MIN_PAIRS = 30
"""Number of products below which an autocorrelation means nothing."""
_SIGMAS_95, _SIGMAS_ALARM = 1.96, 4.0
"""Bounds in standard deviations; watched all the time, four are exceeded in 0.5 % of drives of 15 minutes at 5 Hz."""


class Innovation(NamedTuple):
    """Measured minus expected numbers and their covariance, with the R that the measurement came with."""

    y: Array
    """(m,)"""
    S: Array
    """(m, m)"""


class Whiteness(NamedTuple):
    """Autocorrelation of innovations with the ones before of the same source; 0 on average if they are white."""

    correlation: float
    bound: float
    """95 % of the absolute values of a consistent filter are below it"""
    alarm: float
    """above it the errors are correlated in time"""
    nis: float
    """mean of the same innovations per number measured; 1 if their covariance is right"""


def whitened(innovations: Sequence[Innovation]) -> list[Array]:
    """Return L^-1 y of each innovation, S = L L'; all of one size in one call, which takes a tenth of the time."""
    found: list[Array] = [np.empty(0)] * len(innovations)
    for size in {one.y.size for one in innovations}:
        places = [place for place, one in enumerate(innovations) if one.y.size == size]
        L = _roots(np.array([innovations[place].S for place in places]))
        y = np.array([innovations[place].y for place in places])
        for place, u in zip(places, np.linalg.solve(L, y[:, :, None])[:, :, 0], strict=True):
            found[place] = u
    return found


def _roots(S: Array) -> Array:
    """Return L of each S = L L', (n, m, m); of the nearest S > 0 if rounding has left one that is not."""
    try:
        return np.asarray(np.linalg.cholesky(S))
    except np.linalg.LinAlgError:
        values, vectors = np.linalg.eigh(S)
        least = np.maximum(np.finfo(float).eps * values[:, -1:], np.finfo(float).tiny)
        return np.asarray(vectors * np.sqrt(np.maximum(values, least))[:, None, :])


def whiteness_of(whitened: Iterable[tuple[Hashable, Array]]) -> Whiteness | None:
    """Return the lag-1 autocorrelation of whitened innovations (source, u) in the order of time; None if too few.

    For white innovations, the sum of n products of neighbours divided by the mean square has mean 0 and variance n.
    """
    last: dict[Hashable, Array] = {}
    energy, numbers, product, pairs = 0.0, 0, 0.0, 0
    for source, u in whitened:
        energy, numbers = energy + float(u.dot(u)), numbers + u.size
        before = last.get(source)
        if before is not None and before.size == u.size:
            product, pairs = product + float(u.dot(before)), pairs + u.size
        last[source] = u
    if pairs < _MIN_PAIRS or energy <= 0.0:
        return None
    deviation = 1.0 / math.sqrt(pairs)
    nis = energy / numbers
    return Whiteness(product / pairs / nis, _SIGMAS_95 * deviation, _SIGMAS_ALARM * deviation, nis)


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

    def __init__(self, sources: tuple[str, ...] = ()) -> None:
        """Start with an empty record; ``sources`` are the names of further sources of fixes, kinds FIX + 1, ..."""
        self.names = KINDS | {FIX + 1 + index: f"fixes of {name}" for index, name in enumerate(sources)}
        """of the kinds of measurement"""
        self.rejected: Counter[str] = Counter()
        self.relocated: Counter[str] = Counter()
        self.weighed = 0
        """number of landmarks beyond the gate that were weighed"""
        self._window: deque[tuple[float, int]] = deque(maxlen=WINDOW)
        self._innovations: dict[int, deque[tuple[Hashable, Innovation]]] = {
            kind: deque(maxlen=_WHITENESS_WINDOW) for kind in self.names
        }
        """not yet whitened"""
        self._whitened: dict[int, deque[tuple[Hashable, Array]]] = {
            kind: deque(maxlen=_WHITENESS_WINDOW) for kind in self.names
        }
        self._whiteness: dict[int, Whiteness | None] = dict.fromkeys(self.names)

    def clear(self) -> None:
        """Clear the innovations; the counters stay."""
        self._window.clear()
        for kind in self.names:
            self._innovations[kind].clear()
            self._whitened[kind].clear()
            self._whiteness[kind] = None

    def record(
        self, kind: int, nis: float, outcome: int, innovation: Innovation | None = None, source: Hashable = None
    ) -> None:
        """Add a measurement.

        Args:
            kind: FIX, LANDMARK or HEADING, or FIX + 1, ... for further sources of fixes.
            nis: its NIS.
            outcome: of the gate's decision.
            innovation: None if it is not known.
            source: of the measurement; only innovations of one source are compared with each other.
        """
        if outcome == ACCEPTED:
            numbers = _NUMBERS[min(kind, FIX)] if innovation is None else innovation.y.size
            self._window.append((nis, numbers))
            if innovation is not None:
                self._innovations[kind].append((source, innovation))
        elif outcome == WEIGHED:
            self.weighed += 1
        elif outcome == REJECTED:
            self.rejected[self.names[kind]] += 1
        elif outcome == RELOCATED:
            self.relocated[self.names[kind]] += 1
            self.clear()  # those innovations belong to the estimate that was given up

    def nis(self) -> Nis | None:
        """Return the mean over the window and its chi-square bounds; None if the window is empty."""
        if not self._window:
            return None
        numbers = sum(count for _, count in self._window)
        low, high, alarm = (chi_square_bound(numbers, tail) / numbers for tail in (0.975, 0.025, _FALSE_ALARM))
        return Nis(sum(nis for nis, _ in self._window) / numbers, low, high, alarm)

    def whiteness(self) -> dict[int, Whiteness]:
        """Return the autocorrelation of each kind of measurement of which there are enough."""
        # Computed when asked for, and each innovation once: a status that is sent twice a second needs it.
        for kind, fresh in self._innovations.items():
            if fresh:
                sources, innovations = zip(*fresh, strict=True)
                self._whitened[kind].extend(zip(sources, whitened(innovations), strict=True))
                self._whiteness[kind] = whiteness_of(self._whitened[kind])
                fresh.clear()
        return {kind: one for kind, one in self._whiteness.items() if one is not None}

    def values(self) -> dict[str, str]:
        """Return key-value pairs for a diagnostic status."""
        values = {}
        nis = self.nis()
        if nis is not None:
            values["NIS per number"] = f"{nis.mean:.3f}"
            values["NIS 95 % bounds"] = f"{nis.low:.3f} {nis.high:.3f}"
        for number, white in self.whiteness().items():
            name = self.names[number]
            values[f"NIS per number of {name}"] = f"{white.nis:.3f}"
            values[f"autocorrelation of {name}"] = f"{white.correlation:.3f}"
            values[f"autocorrelation of {name}, 95 % bound"] = f"{white.bound:.3f}"
        if self.weighed:
            values["landmarks weighed"] = str(self.weighed)
        for kind in self.names.values():
            if self.rejected[kind] or self.relocated[kind] or kind == "fixes":
                values[f"{kind} rejected"] = str(self.rejected[kind])
                values[f"relocations by {kind}"] = str(self.relocated[kind])
        return values
