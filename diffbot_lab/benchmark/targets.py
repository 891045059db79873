"""Figures that were promised, and how a benchmark shows them."""

from __future__ import annotations

from typing import Any, NamedTuple


class Target(NamedTuple):
    """One figure that was promised."""

    case: str
    text: str
    value: float | None
    """null if no run gives one; the target is missed then"""
    bound: float
    at_least: bool = False

    @property
    def met(self) -> bool:
        """Whether the value keeps the bound."""
        if self.value is None:
            return False
        return self.value >= self.bound if self.at_least else self.value <= self.bound


def described(targets: list[Target]) -> list[dict[str, Any]]:
    """Return the targets for results.json."""
    return [one._asdict() | {"met": one.met} for one in targets]


def summary(targets: list[Target]) -> list[str]:
    """Count the targets for a terminal, and name those that are missed."""
    missed = [one for one in targets if not one.met]
    lines = [f"Targets: {len(targets) - len(missed)} met, {len(missed)} missed"]
    return lines + [f"  missed: {one.case}, {one.text}: {number(one.value)}, wanted {_wanted(one)}" for one in missed]


def target_table(targets: list[Target]) -> list[str]:
    """Lay out the targets as a table of a page."""
    return [
        "| case | figure | measured | wanted | met |",
        "|---|---|---|---|---|",
        *(
            f"| {one.case} | {one.text} | {number(one.value, 4)} | {_wanted(one)} | {'yes' if one.met else '**no**'} |"
            for one in targets
        ),
    ]


def number(value: float | None, digits: int = 3) -> str:
    """Show a figure, ``-`` for none."""
    return "-" if value is None else f"{value:.{digits}f}"


def _wanted(one: Target) -> str:
    return f"{'>=' if one.at_least else '<='} {one.bound:g}"
