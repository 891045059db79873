"""The command ``diffbot bag``: its verbs, each in a module of its own."""

from __future__ import annotations

from typing import Any

from diffbot_tools.bag.check_command import add_check
from diffbot_tools.bag.filter_command import add_filter
from diffbot_tools.bag.info_command import add_info
from diffbot_tools.bag.merge_command import add_merge
from diffbot_tools.bag.repair_command import add_repair
from diffbot_tools.bag.trim_command import add_trim

_VERBS = (
    add_info,
    add_check,
    add_repair,
    add_trim,
    add_filter,
    add_merge,
)


def add_bag(commands: Any) -> None:
    """Add ``diffbot bag`` to the subparsers of the command line."""
    bag = commands.add_parser("bag", help="look at recorded bags, check and change them (docs/reference/bags.md)")
    verbs = bag.add_subparsers(required=True, metavar="VERB", dest="verb")
    for add in _VERBS:
        add(verbs)
