"""What the commands print about a bag that was not finished."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from diffbot_bag.bag.reader import BagReader


def print_warning(reader: BagReader) -> None:
    """Print one line to stderr if the bag has no index or no metadata.yaml."""
    if reader.warning:
        print(f"diffbot: warning: {reader.warning}", file=sys.stderr)
