"""``diffbot bag filter``: some topics of a bag."""

from __future__ import annotations

import argparse
from typing import Any

from diffbot_bag.bag.topic_selection import TopicSelection
from diffbot_tools.bag.cut_commands import add_paths, make_bag


def add_filter(verbs: Any) -> None:
    """Add ``diffbot bag filter`` to the subparsers of ``diffbot bag``."""
    select = verbs.add_parser("filter", help="write some topics of a bag")
    add_paths(select)
    select.add_argument("--topics", nargs="+", default=[], metavar="TOPIC", help="to keep")
    select.add_argument("--regex", default="", help="keep topics that match as a whole, too")
    select.add_argument("--exclude", nargs="+", default=[], metavar="TOPIC", help="to leave out; takes precedence")
    select.add_argument(
        "--exclude-regex", default="", metavar="REGEX", help="leave out topics whose whole name matches"
    )
    select.add_argument("--types", nargs="+", default=[], metavar="TYPE", help="keep only these, as nav_msgs/msg/Path")
    select.set_defaults(call=_filter, parser=select)


def _filter(options: argparse.Namespace) -> int:
    from diffbot_bag.tools.cut import select  # noqa: PLC0415 - only the called command is imported

    selection = TopicSelection(
        topics=tuple(options.topics),
        regex=options.regex,
        exclude_topics=tuple(options.exclude),
        exclude_regex=options.exclude_regex,
        # Of a bag that has hidden topics, they are kept like all others.
        include_hidden_topics=True,
    )
    if selection == TopicSelection(include_hidden_topics=True) and not options.types:
        options.parser.error("one of --topics, --regex, --exclude, --exclude-regex and --types is needed")
    return make_bag("filter", [options.bag], options.out, lambda bags: select(bags[0], selection, options.types))
