"""Parse times on a command line: ``10s`` after the start of a bag, ``end-30s``, or seconds since 1970."""

from __future__ import annotations

import re
from argparse import ArgumentTypeError

from diffbot_core.stamps import NS_PER_S

UNITS = {"ns": 1, "us": 1000, "ms": 10**6, "s": NS_PER_S, "min": 60 * NS_PER_S, "h": 3600 * NS_PER_S}
"""[ns] duration of each unit"""
FORMS = "10s, 1.5min, start+10s, end-30s, end, or seconds since 1970"
_DURATION = re.compile(r"(\d{1,18})(?:\.(\d{1,18}))?\s*(ns|us|ms|s|min|h)?")
_RELATIVE = re.compile(r"(start|end)(?:\s*([+-])\s*(.+))?")
RelativeTime = tuple[str, int]
"""Origin (``start``, ``end`` or ``epoch``) and offset from the origin [ns]."""


def parse_duration(text: str) -> int:
    """Parse a duration and return it in [ns]; a number without a unit is in seconds.

    Raises:
        ArgumentTypeError: if the text is not a duration.
    """
    number = _DURATION.fullmatch(text.strip())
    if not number:
        raise ArgumentTypeError(f"{text!r}: must be a duration, e.g. 30s or 1.5min ({', '.join(UNITS)})")
    whole, fraction, unit = number.groups()
    factor = UNITS[unit or "s"]
    scale: int = 10 ** len(fraction or "")
    return int(whole) * factor + int(fraction or 0) * factor // scale


def parse_time(text: str) -> RelativeTime:
    """Parse a time. A number with a unit counts from the start of the bag, a number without a unit from 1970.

    Raises:
        ArgumentTypeError: if the text is not a time.
    """
    origin, sign, rest = "start" if text.strip()[-1:].isalpha() else "epoch", "", text
    if relative := _RELATIVE.fullmatch(text.strip()):
        origin, sign, rest = relative.groups()
    try:
        return origin, parse_duration(rest or "0") * (-1 if sign == "-" else 1)
    except ArgumentTypeError:
        raise ArgumentTypeError(f"{text!r}: must be a time: {FORMS}") from None


def resolve_time(time: RelativeTime, start: int, end: int) -> int:
    """Return the absolute time [ns] in a bag whose first and last log times are ``start`` and ``end`` [ns]."""
    origin, offset = time
    # The end of a bag is just after its last message.
    return offset + {"start": start, "end": end + 1, "epoch": 0}[origin]
