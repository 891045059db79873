"""Consistency of the filter: its innovations against their expected covariance, and how many were rejected.

Innovations of a right model are white. Their autocorrelation shows what the NIS does not: fixes whose errors last
longer than the time between them look harmless one by one, and make the filter overconfident.
"""

from __future__ import annotations

import math
from collections import defaultdict, deque
from collections.abc import Collection, Hashable, Iterable, Sequence
from typing import NamedTuple

import numpy as np

from diffbot_control.filter.chi_square import chi_square_bound
from diffbot_control.filter.gate import ACCEPTED, REJECTED, RELOCATED, WEIGHED
from diffbot_control.filter.measurements import FIXES, Array, Innovation, Source
from diffbot_core.units import S_PER_NS

WINDOW = 50
"""Number of accepted measurements in the mean."""
_FALSE_ALARM = 1e-4
"""Probability that the mean of a consistent filter exceeds the alarm bound."""

_WHITENESS_WINDOW = 100
"""Number of accepted measurements of a kind in the autocorrelation."""
_MIN_PAIRS = 30
"""Number of products below which an autocorrelation means nothing."""
_SIGMAS_95, _SIGMAS_ALARM = 1.96, 4.0
"""Bounds in standard deviations; watched all the time, four are exceeded in 0.5 % of drives of 15 minutes at 5 Hz."""


_NO_NUMBERS: Array = np.empty(0)


class Whiteness(NamedTuple):
    """Autocorrelation of innovations with the ones before of the same source; 0 on average if they are white."""

    correlation: float
    bound: float
    """95 % of the absolute values of a consistent filter are below it"""
    alarm: float
    """if the correlation is greater by this than the one that the filter assumes, the filter is overconfident"""
    nis: float
    """mean of the same innovations per number measured; 1 if their covariance is right"""
    periods: tuple[float, ...]
    """[s] between the two measurements of each pair"""


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


def whiteness_of(whitened: Iterable[tuple[Hashable, int, Array]]) -> Whiteness | None:
    """Return the lag-1 autocorrelation of whitened innovations in the order of time; None if there are too few.

    For white innovations, the sum of n products of neighbours divided by the mean square has mean 0 and variance n.

    Args:
        whitened: source, stamp [ns] and whitened innovation of each measurement.
    """
    last: dict[Hashable, tuple[int, Array]] = {}
    energy, numbers, product, pairs = 0.0, 0, 0.0, 0
    periods = []
    for source, stamp, u in whitened:
        energy, numbers = energy + float(u.dot(u)), numbers + u.size
        stamp_before, before = last.get(source, (0, _NO_NUMBERS))
        if before.size == u.size:
            product, pairs = product + float(u.dot(before)), pairs + u.size
            # A late measurement is recorded after newer ones.
            periods.append(abs(stamp - stamp_before) * S_PER_NS)
        last[source] = stamp, u
    if pairs < _MIN_PAIRS or energy <= 0.0:
        return None
    deviation = 1.0 / math.sqrt(pairs)
    nis = energy / numbers
    return Whiteness(product / pairs / nis, _SIGMAS_95 * deviation, _SIGMAS_ALARM * deviation, nis, tuple(periods))


class Nis(NamedTuple):
    """Mean NIS of accepted measurements per number measured; 1 if Q and R are right."""

    mean: float
    low: float
    """95 % of the means of a consistent filter are between these bounds"""
    high: float
    alarm: float
    """above it the covariances are too small for the innovations"""


def mean_nis(window: Collection[tuple[float, int]]) -> Nis | None:
    """Return the mean of NIS values, each with how many numbers it is of; None if there are none."""
    if not window:
        return None
    numbers = sum(count for _, count in window)
    low, high, alarm = (chi_square_bound(numbers, tail) / numbers for tail in (0.975, 0.025, _FALSE_ALARM))
    return Nis(sum(nis for nis, _ in window) / numbers, low, high, alarm)


class _Sensor:
    """Record of one sensor."""

    def __init__(self) -> None:
        self.rejected = self.relocated = 0
        self.fresh: deque[tuple[Source, int, Innovation]] = deque(maxlen=_WHITENESS_WINDOW)
        """innovations that are not yet whitened, with source and stamp"""
        self.whitened: deque[tuple[Source, int, Array]] = deque(maxlen=_WHITENESS_WINDOW)
        self.whiteness: Whiteness | None = None

    def clear(self) -> None:
        """Forget the innovations."""
        self.fresh.clear()
        self.whitened.clear()
        self.whiteness = None


class InnovationMonitor:
    """Record of a filter's innovations, by the names of the sensors."""

    def __init__(self) -> None:
        """Start with an empty record."""
        self.sensors: defaultdict[str, _Sensor] = defaultdict(_Sensor)
        self.weighed = 0
        """number of measurements beyond the gate that were weighed"""
        self._window: deque[tuple[float, int]] = deque(maxlen=WINDOW)

    def clear(self) -> None:
        """Clear the innovations; the counters stay."""
        self._window.clear()
        for one in self.sensors.values():
            one.clear()

    def record(
        self, source: Source, nis: float, outcome: int, innovation: Innovation | None = None, stamp: int = 0
    ) -> None:
        """Add a measurement.

        Args:
            source: of the measurement; only innovations of one source are compared with each other.
            nis: its NIS.
            outcome: of the gate's decision.
            innovation: None if it could not be computed.
            stamp: [ns] of the measurement.
        """
        sensor = self.sensors[source.sensor]
        if outcome == ACCEPTED and innovation is not None:
            self._window.append((nis, innovation.y.size))
            sensor.fresh.append((source, stamp, innovation))
        elif outcome == WEIGHED:
            self.weighed += 1
        elif outcome == REJECTED:
            sensor.rejected += 1
        elif outcome == RELOCATED:
            sensor.relocated += 1
            self.clear()  # those innovations belong to the estimate that was given up

    def nis(self) -> Nis | None:
        """Return the mean over the window and its chi-square bounds; None if the window is empty."""
        return mean_nis(self._window)

    def whiteness(self) -> dict[str, Whiteness]:
        """Return the autocorrelation of each sensor of which there is enough."""
        # Computed when asked for, and each innovation once: a status that is sent twice a second needs it.
        for one in self.sensors.values():
            if one.fresh:
                sources, stamps, innovations = zip(*one.fresh, strict=True)
                one.whitened.extend(zip(sources, stamps, whitened(innovations), strict=True))
                one.whiteness = whiteness_of(one.whitened)
                one.fresh.clear()
        return {name: one.whiteness for name, one in self.sensors.items() if one.whiteness is not None}

    def values(self) -> dict[str, str]:
        """Return key-value pairs for a diagnostic status."""
        values = {}
        nis = self.nis()
        if nis is not None:
            values["NIS per number"] = f"{nis.mean:.3f}"
            values["NIS 95 % bounds"] = f"{nis.low:.3f} {nis.high:.3f}"
        for name, white in self.whiteness().items():
            values[f"NIS per number of {name}"] = f"{white.nis:.3f}"
            values[f"autocorrelation of {name}"] = f"{white.correlation:.3f}"
            values[f"autocorrelation of {name}, 95 % bound"] = f"{white.bound:.3f}"
        if self.weighed:
            values["landmarks weighed"] = str(self.weighed)
        for name in {FIXES: None, **self.sensors}:
            sensor = self.sensors[name]
            if sensor.rejected or sensor.relocated or name == FIXES:
                values[f"{name} rejected"] = str(sensor.rejected)
                values[f"relocations by {name}"] = str(sensor.relocated)
        return values
