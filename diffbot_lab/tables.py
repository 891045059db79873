"""Format tables of results."""

from __future__ import annotations

from collections.abc import Iterable


def markdown_table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> list[str]:
    """Return the lines of a Markdown table."""
    titles = list(head)
    first, *others = [f"| {' | '.join(cells)} |" for cells in (titles, *rows)]
    return [first, "|---" * len(titles) + "|", *others]


def number(value: float | None, digits: int = 3) -> str:
    """Return a number with ``digits`` decimals, or ``-`` for None."""
    return "-" if value is None else f"{value:.{digits}f}"
