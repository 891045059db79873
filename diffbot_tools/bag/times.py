"""Times as people write them on a command line: ``10s`` after the start, ``end-30s``, or seconds since 1970."""

from __future__ import annotations

import re
from argparse import ArgumentTypeError

from diffbot_core.stamps import NS_PER_S

UNITS = {"ns": 1, "us": 1000, "ms": 10**6, "s": NS_PER_S, "min": 60 * NS_PER_S, "h": 3600 * NS_PER_S}
"""[ns]"""
FORMS = "10s, 1.5min, start+10s, end-30s, end, or seconds since 1970"
_DURATION = re.compile(r"(\d{1,18})(?:\.(\d{1,18}))?\s*(ns|us|ms|s|min|h)?")
_RELATIVE = re.compile(r"(start|end)(?:\s*([+-])\s*(.+))?")
RelativeTime = tuple[str, int]
"""``start`` or ``end`` of the bag or ``epoch``, and the offset from there [ns]."""


def parse_duration(text: str) -> int:
    """Return a duration [ns]; without a unit, the text is in seconds.

    Raises:
        ArgumentTypeError: if it is not a duration.
    """
    number = _DURATION.fullmatch(text.strip())
    if not number:
        raise ArgumentTypeError(f"{text!r}: must be a duration, e.g. 30s or 1.5min ({', '.join(UNITS)})")
    whole, fraction, unit = number.groups()
    factor = UNITS[unit or "s"]
    scale: int = 10 ** len(fraction or "")
    return int(whole) * factor + int(fraction or 0) * factor // scale


def parse_time(text: str) -> RelativeTime:
    """Return a time: a number with a unit counts from the start of the bag, one without a unit from 1970.

    Raises:
        ArgumentTypeError: if it is not a time.
    """
    origin, sign, rest = "start" if text.strip()[-1:].isalpha() else "epoch", "", text
    if relative := _RELATIVE.fullmatch(text.strip()):
        origin, sign, rest = relative.groups()
    try:
        return origin, parse_duration(rest or "0") * (-1 if sign == "-" else 1)
    except ArgumentTypeError:
        raise ArgumentTypeError(f"{text!r}: must be a time: {FORMS}") from None


def resolve_time(time: RelativeTime, start: int, end: int) -> int:
    """Return the log time [ns] in a bag; ``start`` and ``end``: log times of its first and last message [ns]."""
    origin, offset = time
    # The end of a bag is just after its last message.
    return offset + {"start": start, "end": end + 1, "epoch": 0}[origin]
