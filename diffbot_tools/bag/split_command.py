"""``diffbot bag split``: a bag in several files."""

from __future__ import annotations

import argparse
import re
from typing import Any

from diffbot_bag.tools.time_text import parse_duration
from diffbot_tools.arguments import whole
from diffbot_tools.bag.cut_commands import add_paths, make_bag, text_type

UNITS = {"": 1, "k": 10**3, "M": 10**6, "G": 10**9, "Ki": 2**10, "Mi": 2**20, "Gi": 2**30}
"""[bytes]"""
MIN_SIZE = 1000


def add_split(verbs: Any) -> None:
    """Add ``diffbot bag split`` to the subparsers of ``diffbot bag``."""
    split = verbs.add_parser("split", help="write a bag in several files, each of which can be used alone")
    add_paths(split)
    split.add_argument("--size", type=text_type("size", parse_size), default=0, help="of a file at most, e.g. 500M")
    split.add_argument(
        "--duration", type=text_type("duration", _positive), default=0, help="of a file in log time, e.g. 60s, 5min"
    )
    split.add_argument("--count", type=whole(1, 10**18), default=0, help="of messages in a file")
    split.set_defaults(call=_split, parser=split)


def parse_size(text: str) -> int:
    """Return a size [bytes], e.g. 500M, 2GiB.

    Raises:
        ValueError: if it is none, or too small for a file.
    """
    size = re.fullmatch(r"(\d{1,9})(?:\.(\d{1,9}))?\s*(k|M|G|Ki|Mi|Gi)?B?", text.strip())
    if not size:
        raise ValueError(f"{text!r}: must be a size, e.g. 500M or 2GiB")
    whole_part, fraction, unit = size.groups()
    factor = UNITS[unit or ""]
    scale: int = 10 ** len(fraction or "")
    found = int(whole_part) * factor + int(fraction or 0) * factor // scale
    if found < MIN_SIZE:
        raise ValueError(f"{text!r}: must be >= {MIN_SIZE} bytes")
    return found


def _positive(text: str) -> int:
    if (found := parse_duration(text)) == 0:
        raise ValueError(f"{text!r}: must be > 0")
    return found


def _split(options: argparse.Namespace) -> int:
    from diffbot_bag.tools.cut import split  # noqa: PLC0415 - only the called command is imported
    from diffbot_bag.tools.split_bag import FileLimits  # noqa: PLC0415

    limits = FileLimits(options.size, options.duration, options.count)
    if not any(limits):
        options.parser.error("one of --size, --duration and --count is needed")
    return make_bag("split", [options.bag], options.out, lambda bags: split(bags[0], limits))
