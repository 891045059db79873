"""Tables of results: Markdown, and figures as text."""

from __future__ import annotations

from collections.abc import Iterable


def markdown_table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> list[str]:
    """Return the lines of a Markdown table."""
    titles = list(head)
    return [_line(titles), "|---" * len(titles) + "|", *map(_line, rows)]


def _line(cells: Iterable[str]) -> str:
    return f"| {' | '.join(cells)} |"


def number(value: float | None, digits: int = 3) -> str:
    """Format a figure with ``digits`` decimals, ``-`` for None."""
    return "-" if value is None else f"{value:.{digits}f}"
