"""``diffbot bag merge``: one bag of several."""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import Any

from diffbot_tools.bag.cut_commands import make_bag


def add_merge(verbs: Any) -> None:
    """Add ``diffbot bag merge`` to the subparsers of ``diffbot bag``."""
    merge = verbs.add_parser("merge", help="write one bag of several, in the order of log time")
    merge.add_argument("bags", type=Path, nargs="+", metavar="IN", help="folders of bags, or .mcap files; two or more")
    merge.add_argument("out", type=Path, metavar="OUT", help="folder of the new bag, which must not exist")
    merge.set_defaults(call=_merge, parser=merge)


def _merge(options: argparse.Namespace) -> int:
    from diffbot_bag.tools.cut import merge  # noqa: PLC0415 - only the called command is imported

    if len(options.bags) < 2:
        options.parser.error("two bags or more are needed, and the name of the new one")
    resolved = [os.path.realpath(path.expanduser()) for path in options.bags]
    if len(set(resolved)) < len(resolved):
        options.parser.error("a bag is given twice")
    return make_bag("merge", options.bags, options.out, merge)
