"""Repair of unfinished bags: its speed, beside copying by the mcap library, and its memory."""

from __future__ import annotations

import random
import shutil
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from costs import cost_of
from measures import OURS, Measure, Pair
from part_cut import copy_by_mcap

from diffbot_bag.bag.writer import BagWriter
from diffbot_bag.tools.repair import repair_bag

TOPICS = 8
MEASURES = (
    Measure("small", "messages of 300 bytes: CPU, beside copying by the mcap library", "MiB/s"),
    Measure("large", "messages of 20 kB: the same", "MiB/s"),
    Measure("memory", "bag of 2 GiB: memory", "MB", OURS, at_most=200.0),
)
REPAIR = """
import sys
from pathlib import Path
from diffbot_bag.tools.repair import repair_bag
repair_bag(Path(sys.argv[1]), Path(sys.argv[2]))
"""


def unfinished_bag(folder: Path, size: int, message_size: int) -> Path:
    """Write a bag of ``size`` [bytes] that is not finished; half of each message does not compress."""
    writer = BagWriter(folder)
    channels = [writer.add_topic(f"/bench_{index}", "geometry_msgs/msg/Twist") for index in range(TOPICS)]
    noise = random.Random(3).randbytes(2**24)
    half = message_size // 2
    for index in range(size // half):
        start = index * 4099 % (len(noise) - half)
        stamp = 1_700_000_000_000_000_000 + index * 125_000
        writer.write(channels[index % TOPICS], bytes(message_size - half) + noise[start : start + half], stamp, stamp)
    writer.flush()
    return writer.path


def speed(key: str, size: int, message_size: int, folder: Path) -> Iterator[dict[str, Pair]]:
    """Compare a repair with a copy by the mcap library, in CPU time: one after the other in each round."""
    source = unfinished_bag(folder / key, size, message_size)
    megabytes = source.stat().st_size / 2**20
    for _ in range(3):
        begin = time.process_time()
        repair_bag(source, folder / "fixed")
        middle = time.process_time()
        copy_by_mcap([source], folder / "copy.mcap")
        end = time.process_time()
        shutil.rmtree(folder / "fixed")
        yield {key: Pair(megabytes / (middle - begin), megabytes / (end - middle))}


def memory(size: int, folder: Path) -> dict[str, Pair]:
    """Repair a large bag in a process of its own."""
    source = unfinished_bag(folder / "large_bag", size, 4096)
    cost = cost_of(sys.executable, "-c", REPAIR, source, folder / "repaired")
    return {"memory": Pair(cost.memory)}


def measure(quick: bool, folder: Path) -> Iterator[dict[str, Pair]]:
    """Yield the rounds for small and large messages, and the memory."""
    size = 2**21 if quick else 2**27
    yield from speed("small", size // 4, 300, folder)
    yield from speed("large", size, 20_000, folder)
    yield memory(2**24 if quick else 2**31, folder)
