"""Targets of the benchmarks: a figure and its bound each, evaluated and shown in one way for law and filter."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple


class Target(NamedTuple):
    """One figure and the bound it has to meet."""

    case: str
    text: str
    value: float | None
    """None if no run yields one; the target is then missed"""
    bound: float
    at_least: bool = False
    """the bound is a lower one"""

    @property
    def met(self) -> bool:
        """True if there is a value and it meets the bound."""
        if self.value is None:
            return False
        return self.value >= self.bound if self.at_least else self.value <= self.bound

    @property
    def condition(self) -> str:
        """The bound as text, such as ``<= 0.05``."""
        return f"{'>=' if self.at_least else '<='} {self.bound:g}"


def evaluate_targets(targets: Iterable[Target]) -> list[dict[str, Any]]:
    """Return the targets for results.json, each with ``met``."""
    return [one._asdict() | {"met": one.met} for one in targets]


def summary(targets: list[Target]) -> list[str]:
    """Count the targets for a terminal, and list those that are missed."""
    missed = [one for one in targets if not one.met]
    lines = [f"Targets: {len(targets) - len(missed)} met, {len(missed)} missed"]
    return lines + [f"  missed: {one.case}, {one.text}: {number(one.value)}, not {one.condition}" for one in missed]


def markdown_table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> list[str]:
    """Return the lines of a Markdown table."""
    titles = list(head)
    return [_line(titles), "|---" * len(titles) + "|", *map(_line, rows)]


def _line(cells: Iterable[str]) -> str:
    return f"| {' | '.join(cells)} |"


def number(value: float | None, digits: int = 3) -> str:
    """Format a figure, ``-`` for none."""
    return "-" if value is None else f"{value:.{digits}f}"
