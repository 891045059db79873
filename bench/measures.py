"""What the benchmarks measure, against which targets, and their table."""

from __future__ import annotations

import statistics
from typing import Any, NamedTuple

RATIO, OURS = "ratio", "ours"


class BenchError(Exception):
    """Something could not be measured."""


class Pair(NamedTuple):
    """One round: this project and, where there is one, the reference measured beside it."""

    ours: float
    reference: float | None = None


class Measure(NamedTuple):
    """One row of the table: a target is a bound of the ratio or of our own figure; without one it is information."""

    key: str
    text: str
    unit: str
    target_of: str = RATIO
    at_most: float | None = None
    at_least: float | None = None

    @property
    def target(self) -> str:
        """The target in words."""
        unit = "x" if self.target_of == RATIO else self.unit
        if self.at_most is not None:
            return f"<= {self.at_most:g} {unit}".rstrip()
        return f">= {self.at_least:g} {unit}".rstrip() if self.at_least is not None else ""

    def is_met(self, value: float) -> bool | None:
        """Whether ``value`` keeps the target; None without one."""
        if self.at_most is not None:
            return value <= self.at_most
        return value >= self.at_least if self.at_least is not None else None


class Row(NamedTuple):
    """Medians over the rounds; the ratio is the median of the ratios of each round."""

    text: str
    unit: str
    ours: float
    reference: float | None
    ratio: float | None
    target: str
    met: bool | None
    spread: tuple[float, float]
    """smallest and largest ratio of a round, or our smallest and largest figure where there is no reference"""
    rounds: int


def make_row(measure: Measure, pairs: list[Pair]) -> Row:
    """Summarise the rounds of one measure, at least one."""
    ours = statistics.median(pair.ours for pair in pairs)
    references = [pair.reference for pair in pairs if pair.reference is not None]
    reference = statistics.median(references) if references else None
    each = [pair.ours / pair.reference if pair.reference is not None else pair.ours for pair in pairs]
    ratio = statistics.median(each) if references else None
    met = measure.is_met(ours if ratio is None or measure.target_of == OURS else ratio)
    spread = min(each), max(each)
    return Row(measure.text, measure.unit, ours, reference, ratio, measure.target, met, spread, len(pairs))


def make_rows(measures: tuple[Measure, ...], samples: dict[str, list[Pair]]) -> dict[str, dict[str, Any]]:
    """Return the rows of all that was measured by their keys, in the order of ``measures``."""
    return {one.key: make_row(one, samples[one.key])._asdict() for one in measures if samples.get(one.key)}
