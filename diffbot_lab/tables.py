"""Format tables of results."""

from __future__ import annotations

from collections.abc import Iterable


def markdown_table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> list[str]:
    """Return the lines of a Markdown table."""
    titles = list(head)
    return [_line(titles), "|---" * len(titles) + "|", *map(_line, rows)]


def _line(cells: Iterable[str]) -> str:
    return f"| {' | '.join(cells)} |"


def number(value: float | None, digits: int = 3) -> str:
    """Return a number with ``digits`` decimals, or ``-`` for None."""
    return "-" if value is None else f"{value:.{digits}f}"
