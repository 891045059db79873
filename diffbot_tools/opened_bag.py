"""Open a bag for a command."""

from __future__ import annotations

import sys
from pathlib import Path

from diffbot_bag.bag import CDR, BagReader
from diffbot_core.errors import shown


def open_bag(path: Path, *, decodes: bool = True) -> BagReader:
    """Open a bag, and print one line to stderr if it was not finished.

    Args:
        path: folder or MCAP file.
        decodes: the command decodes messages; name the topics whose encoding it cannot decode, too.

    Raises:
        DiffbotError: if it is missing, not a rosbag2 MCAP bag, or damaged.
    """
    reader = BagReader(path)
    if reader.warning:
        print(f"diffbot: warning: {reader.warning}", file=sys.stderr)
    foreign = [f"{name} as {topic.encoding}" for name, topic in reader.topics.items() if topic.encoding != CDR]
    if decodes and foreign:
        print(
            f"diffbot: warning: {shown(path)}: only {CDR} is decoded, not {shown(', '.join(foreign))}", file=sys.stderr
        )
    return reader
