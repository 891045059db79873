"""Open a bag for a command, and print its warnings."""

from __future__ import annotations

import sys
from pathlib import Path

from diffbot_bag.bag import CDR, BagReader
from diffbot_core.errors import shown


def open_bag(path: Path, *, decodes: bool = True) -> BagReader:
    """Open a bag; print a warning to stderr if it was not finished, or has messages that cannot be decoded.

    Args:
        path: folder or MCAP file.
        decodes: True if the command decodes messages.

    Raises:
        DiffbotError: if the bag is missing, damaged, or not an MCAP bag of rosbag2.
    """
    reader = BagReader(path)
    if reader.warning:
        print(f"diffbot: warning: {reader.warning}", file=sys.stderr)
    others = [f"{name} as {topic.encoding}" for name, topic in reader.topics.items() if topic.encoding != CDR]
    if decodes and others:
        print(
            f"diffbot: warning: {shown(path)}: only {CDR} is decoded, not {shown(', '.join(others))}", file=sys.stderr
        )
    return reader
