"""``diffbot bag trim``: a part of a bag."""

from __future__ import annotations

import argparse
from typing import Any

from diffbot_bag.tools.time_text import FORMS, TimeText, parse_duration, parse_time, span_of
from diffbot_tools.bag.cut_commands import add_paths, make_bag, text_type


def add_trim(verbs: Any) -> None:
    """Add ``diffbot bag trim`` to the subparsers of ``diffbot bag``."""
    trim = verbs.add_parser("trim", help="write a part of a bag, by time")
    add_paths(trim)
    time = text_type("time", parse_time)
    trim.add_argument("--from", dest="first", type=time, metavar="TIME", help=f"earliest log time ({FORMS})")
    trim.add_argument("--to", dest="last", type=time, metavar="TIME", help="end of the log times, itself left out")
    trim.add_argument(
        "--last", dest="rest", type=text_type("duration", parse_duration), metavar="DURATION", help="the end, e.g. 30s"
    )
    trim.add_argument(
        "--no-latched",
        dest="latched",
        action="store_false",
        help="do not begin with the last earlier messages of latched topics",
    )
    trim.set_defaults(call=_trim, parser=trim)


def _trim(options: argparse.Namespace) -> int:
    from diffbot_bag.tools.cut import trim  # noqa: PLC0415 - only the called command is imported

    first, last = options.first, options.last
    if options.rest is not None:
        if first or last:
            options.parser.error("--last: not together with --from or --to")
        first = TimeText("end", -options.rest, f"end-{options.rest}ns")
    elif not first and not last:
        options.parser.error("one of --from, --to and --last is needed")
    return make_bag(
        "trim",
        [options.bag],
        options.out,
        lambda bags: trim(bags[0], span_of(bags[0].span, first, last), latched=options.latched),
    )
