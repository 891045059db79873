"""What the commands that make a bag of others have in common."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

from diffbot_tools.bag.unfinished_bags import print_warning

if TYPE_CHECKING:
    from diffbot_bag.bag.metadata import BagMetadata
    from diffbot_bag.tools.cut import NewBag
    from diffbot_bag.tools.source_bag import SourceBag


def text_type(name: str, parse: Callable[[str], Any]) -> Callable[[str], Any]:
    """Return a type for argparse that shows the text of the ValueErrors of ``parse``."""

    def parsed(text: str) -> Any:
        try:
            return parse(text)
        except ValueError as error:
            raise argparse.ArgumentTypeError(str(error)) from None

    parsed.__name__ = name
    return parsed


def add_paths(parser: argparse.ArgumentParser) -> None:
    """Add the bag to read and the bag to write."""
    parser.add_argument("bag", type=Path, metavar="IN", help="folder of the bag, or an .mcap file")
    parser.add_argument("out", type=Path, metavar="OUT", help="folder of the new bag, which must not exist")


def make_bag(verb: str, inputs: Sequence[Path], out: Path, plan: Callable[[list[SourceBag]], NewBag]) -> int:
    """Write the bag that ``plan`` makes of these and print one line about it; return the exit status.

    Raises:
        DiffbotError: if a bag cannot be read or the new one cannot be written.
    """
    from tqdm import tqdm  # noqa: PLC0415 - only the called command is imported

    from diffbot_bag.bag.new_bag import check_new  # noqa: PLC0415
    from diffbot_bag.tools.source_bag import SourceBag  # noqa: PLC0415

    check_new(out)
    with ExitStack() as stack:
        bags = [stack.enter_context(SourceBag(path)) for path in inputs]
        for bag in bags:
            print_warning(bag)
        new = plan(bags)
        with tqdm(
            total=new.size, desc=verb, unit="B", unit_scale=True, unit_divisor=1024, disable=None, delay=1, leave=False
        ) as bar:
            written = new.write(out, bar.update)
    print(f"{out}: {_summary(written)}")
    return 0


def _summary(written: BagMetadata) -> str:
    seconds = written.duration * 1e-9
    files = f" in {len(written.files)} files" if len(written.files) > 1 else ""
    return f"{written.message_count} messages of {len(written.topics)} topics, {seconds:.3f} s{files}"
