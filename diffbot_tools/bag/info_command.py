"""``diffbot bag info``: what a bag holds, in the form of ``ros2 bag info`` with figures of each topic."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from diffbot_bag.tools.bag_info import BagInfo, Observer


def add_info(verbs: Any) -> None:
    """Add ``diffbot bag info`` to the subparsers of ``diffbot bag``."""
    info = verbs.add_parser("info", help="files, times and topics, with rates, gaps, losses and latency of stamps")
    info.add_argument("bag", type=Path, help="folder of the bag, or an .mcap file")
    info.add_argument("--quick", action="store_true", help="only from the index: no figures of messages")
    info.add_argument("--json", action="store_true", help="print JSON (docs/reference/bags.md)")
    info.set_defaults(call=_call)


def _call(options: argparse.Namespace) -> int:
    from diffbot_bag.tools.bag_info import info_as_plain  # noqa: PLC0415 - only the called command is imported
    from diffbot_tools.bag.info_text import info_text  # noqa: PLC0415

    info = read_with_bar(options.bag, quick=options.quick)
    if options.json:
        json.dump(info_as_plain(info), sys.stdout, indent=1)
        print()
    else:
        print(info_text(info))
    return 0


def read_with_bar(path: Path, *, quick: bool = False, observers: Mapping[str, Observer] | None = None) -> BagInfo:
    """Do what read_info does, with a bar on a terminal for what takes longer than a second.

    Raises:
        DiffbotError: if it is not a bag, or is damaged.
    """
    from tqdm import tqdm  # noqa: PLC0415

    from diffbot_bag.tools.bag_info import read_info  # noqa: PLC0415

    if quick:
        return read_info(path, quick=True)
    total = read_info(path, quick=True).message_count
    with tqdm(desc=path.name, total=total, unit="message", unit_scale=True, disable=None, delay=1.0) as bar:
        return read_info(path, progress=bar.update, observers=observers)
