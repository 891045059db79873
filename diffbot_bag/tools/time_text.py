"""Times as people write them on a command line: ``10s`` after the start, ``end-30s``, or seconds since 1970."""

from __future__ import annotations

import re
from typing import NamedTuple

from diffbot_bag.tools.span import Span
from diffbot_core.errors import DiffbotError, InvalidValueError
from diffbot_core.units import NS_PER_S

UNITS = {"ns": 1, "us": 1000, "ms": 10**6, "s": NS_PER_S, "min": 60 * NS_PER_S, "h": 3600 * NS_PER_S}
"""[ns]"""
FORMS = "10s, 1.5min, start+10s, end-30s, end, or seconds since 1970"
_DURATION = re.compile(r"(\d{1,18})(?:\.(\d{1,18}))?\s*(ns|us|ms|s|min|h)?")
_RELATIVE = re.compile(r"(start|end)(?:\s*([+-])\s*(.+))?")


class TimeText(NamedTuple):
    """A time relative to something in a bag."""

    origin: str
    """``start`` or ``end`` of the bag, or ``epoch``"""
    offset: int
    """[ns]"""
    text: str

    def in_span(self, bag: Span) -> int:
        """Return the time [ns]; ``bag`` is the span of the bag."""
        return self.offset + {"start": bag.start, "end": bag.end, "epoch": 0}[self.origin]


def parse_duration(text: str) -> int:
    """Return a duration [ns]; without a unit, the text is in seconds.

    Raises:
        ValueError: if it is none.
    """
    number = _DURATION.fullmatch(text.strip())
    if not number:
        raise ValueError(f"{text!r}: must be a duration, e.g. 30s or 1.5min ({', '.join(UNITS)})")
    whole, fraction, unit = number.groups()
    factor = UNITS[unit or "s"]
    scale: int = 10 ** len(fraction or "")
    return int(whole) * factor + int(fraction or 0) * factor // scale


def parse_time(text: str) -> TimeText:
    """Return a time: a number with a unit counts from the start of the bag, one without a unit from 1970.

    Raises:
        ValueError: if it is none.
    """
    try:
        if relative := _RELATIVE.fullmatch(text.strip()):
            origin, sign, rest = relative.groups()
            return TimeText(origin, parse_duration(rest or "0") * (-1 if sign == "-" else 1), text)
        return TimeText("start" if text.strip()[-1:].isalpha() else "epoch", parse_duration(text), text)
    except ValueError:
        raise ValueError(f"{text!r}: must be a time: {FORMS}") from None


def span_of(bag: Span, first: TimeText | None, last: TimeText | None) -> Span:
    """Return the span from ``first`` to just before ``last``, either of which may be left out.

    Args:
        bag: first log time, and the time just after the last [ns].
        first: must not be after the bag; an absolute one not before it either.
        last: must be after ``first`` and after the start of the bag.

    Raises:
        DiffbotError: if the span is empty or outside of the bag.
    """
    length = f"the bag lasts {(bag.end - bag.start) / NS_PER_S:.9g} s"
    unix = f"{_unix(bag.start)} to {_unix(bag.end)}"
    start, end = bag
    if first:
        start = first.in_span(bag)
        if start >= bag.end:
            raise InvalidValueError("from", first.text, f"before the end of the bag ({length}, {unix} since 1970)")
        if start < bag.start and first.origin == "epoch":
            raise InvalidValueError(
                "from", first.text, f"in the bag ({unix} since 1970); with a unit it counts from the start: 10s"
            )
    if last:
        end = last.in_span(bag)
        if end <= bag.start:
            raise InvalidValueError("to", last.text, f"after the start of the bag ({length}, {unix} since 1970)")
    if start >= end:
        raise DiffbotError(f"from = {first.text if first else 'start'!r}: must be before to = {last.text!r}")  # type: ignore[union-attr]
    return Span(max(start, bag.start), min(end, bag.end))


def _unix(time: int) -> str:
    return f"{time // NS_PER_S}.{time % NS_PER_S:09}"
