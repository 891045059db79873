"""A span of log times."""

from __future__ import annotations

from typing import NamedTuple

ALWAYS = 2**64
"""[ns] later than every log time"""


class Span(NamedTuple):
    """Log times [ns] from ``start`` to just before ``end``."""

    start: int = 0
    end: int = ALWAYS
