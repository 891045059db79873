"""Trim, filter, split and merge of a bag of 2 GiB: time and memory of each command, beside the mcap library."""

from __future__ import annotations

import shutil
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path

import numpy as np
from costs import DIFFBOT, Cost, cost_of
from mcap.exceptions import McapError
from mcap.records import Channel, Message, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import Writer
from measures import OURS, BenchError, Measure, Pair

from diffbot_bag.bag.qos import Qos, dump_profiles
from diffbot_bag.mcap.whole_chunk import DEFAULT_COMPRESSION
from diffbot_bag.tools.channels import Channels
from diffbot_bag.tools.cut import merge
from diffbot_bag.tools.output_bag import Description, OutputBag
from diffbot_bag.tools.source_bag import Row, SourceBag

BEGIN = 1_700_000_000_000_000_000
TOPICS = {"/camera": (33_333_333, 100_000), "/odom": (1_000_000, 306), "/map": (10**11, 5000)}
"""Period [ns] and size [bytes] of the messages: 3.3 MB/s."""
MEASURES = (
    Measure("trim", "trim of 10 s", "s", OURS, at_most=1.0),
    Measure("split", "split by duration: read", "MB/s"),
    Measure("filter", "filter of one topic out of all chunks: read", "MB/s"),
    Measure("merge", "merge of two bags, interleaved: CPU, beside copying by the mcap library", "MB/s", at_least=0.7),
    Measure("small", "merge of messages of 306 bytes: the same", "MB/s", at_least=0.7),
    Measure("memory", "memory of the command that needs most", "MB", OURS, at_most=200.0),
)


def channels(topics: Sequence[str]) -> Channels:
    """Return the channels of a bag with these topics."""
    schemas = {1: Schema(id=1, name="std_msgs/msg/ByteMultiArray", encoding="ros2msg", data=b"byte[] data\n")}
    found, profiles = {}, {}
    for number, topic in enumerate(topics, start=1):
        qos = (Qos(durability="transient_local" if topic == "/map" else "volatile"),)
        metadata = {"offered_qos_profiles": dump_profiles(qos), "topic_type_hash": ""}
        found[number] = Channel(id=number, topic=topic, message_encoding="cdr", schema_id=1, metadata=metadata)
        profiles[number] = qos
    return Channels(schemas, found, profiles, [])


def rows(topics: Sequence[str], seconds: float, offset: int) -> Iterator[list[Row]]:
    """Yield the messages of each second: random bytes, of which there are few different messages."""
    rng = np.random.default_rng(offset)
    pool = {topic: [rng.bytes(TOPICS[topic][1]) for _ in range(20)] for topic in topics}
    for second in range(int(seconds)):
        found = []
        for number, topic in enumerate(topics, start=1):
            period = TOPICS[topic][0]
            for index in range(-(-second * 10**9 // period), -(-(second + 1) * 10**9 // period)):
                stamp = BEGIN + index * period + offset
                head = index.to_bytes(4, "little") + 2 * stamp.to_bytes(8, "little")
                found.append((stamp, number, head + pool[topic][index % 20]))
        yield sorted(found, key=lambda row: row[0])


def write_bag(folder: Path, size: float, topics: Sequence[str] = tuple(TOPICS), offset: int = 0) -> float:
    """Write a bag of about this size [bytes] and return its duration [s]."""
    seconds = size / sum(TOPICS[topic][1] * 1e9 / TOPICS[topic][0] for topic in topics)
    with OutputBag(folder, channels(topics), Description({}, "jazzy", DEFAULT_COMPRESSION, ())) as bag:
        for second in rows(topics, seconds, offset):
            bag.write(second)
        bag.finish()
    return seconds


def size_of(*folders: Path) -> float:
    """Size of all files [MB]."""
    return sum(file.stat().st_size for folder in folders for file in folder.iterdir()) / 1e6


def copy_by_mcap(paths: Sequence[Path], out: Path) -> None:
    """Copy files with the mcap library, one after the other; unfinished ones as far as it reads."""
    with out.open("wb") as target:
        writer = Writer(target)
        writer.start(profile="ros2")
        for path in paths:
            schemas: dict[int, int] = {}
            channels: dict[int, int] = {}
            with path.open("rb") as source, suppress(McapError):
                for one in StreamReader(source).records:
                    if isinstance(one, Schema):
                        schemas[one.id] = writer.register_schema(one.name, one.encoding, one.data)
                    elif isinstance(one, Channel):
                        schema = schemas[one.schema_id]
                        channels[one.id] = writer.register_channel(one.topic, "cdr", schema, one.metadata)
                    elif isinstance(one, Message):
                        number = channels[one.channel_id]
                        writer.add_message(number, one.log_time, one.data, one.publish_time, one.sequence)
        writer.finish()


def diffbot_bag(*arguments: object) -> Cost:
    """Run ``diffbot bag`` in a process of its own."""
    return cost_of(*DIFFBOT, "bag", *arguments)


def merge_here(paths: Sequence[Path], out: Path) -> None:
    """Merge in this process."""
    with ExitStack() as stack:
        merge([stack.enter_context(SourceBag(path)) for path in paths]).write(out, lambda count: None)


def one_bag(folder: Path, size: float) -> tuple[dict[str, Pair], float]:
    """Trim, filter and split a bag; return the figures and the largest memory [MB]."""
    bag, out = folder / "bag", folder / "out"
    seconds = write_bag(bag, size)
    megabytes, middle = size_of(bag), seconds / 2
    calls = {
        "trim": ("--from", f"{middle:.3f}s", "--to", f"{middle + 10:.3f}s"),
        "filter": ("--topics", "/odom"),
        "split": ("--duration", f"{seconds / 7:.3f}s"),
    }
    costs = {}
    for verb, flags in calls.items():
        costs[verb] = diffbot_bag(verb, bag, out, *flags)
        shutil.rmtree(out)
    shutil.rmtree(bag)
    figures = {"trim": Pair(costs["trim"].wall)}
    figures |= {verb: Pair(megabytes / costs[verb].wall) for verb in ("filter", "split")}
    return figures, max(cost.memory for cost in costs.values())


def two_bags(folder: Path, size: float, topics: Sequence[str]) -> tuple[float, Pair]:
    """Merge two bags; return the memory [MB] of the command, and the rates of an eighth in this process [MB/s]."""
    a, b, out = (folder / one for one in ("a", "b", "out"))
    for share, clean in ((2, True), (16, False)):
        write_bag(a, size / share, topics)
        write_bag(b, size / share, topics, 500_000)
        if clean:
            memory = diffbot_bag("merge", a, b, out).memory
            for one in (a, b, out):
                shutil.rmtree(one)
    megabytes = size_of(a, b)
    begin = time.process_time()
    merge_here([a, b], out)
    between = time.process_time()
    copy_by_mcap([a / "a_0.mcap", b / "b_0.mcap"], folder / "copy.mcap")
    rates = Pair(megabytes / (between - begin), megabytes / (time.process_time() - between))
    (folder / "copy.mcap").unlink()
    for one in (a, b, out):
        shutil.rmtree(one)
    return memory, rates


def measure(quick: bool, folder: Path) -> Iterator[dict[str, Pair]]:
    """Yield the figures of one bag, and of two."""
    size = 2**23 if quick else 2**31
    if shutil.disk_usage(folder).free < 4 * size:
        raise BenchError(f"{folder} has too little space: must be >= {4 * size / 1e9:.1f} GB")
    figures, memory = one_bag(folder, size)
    yield figures
    of_merge, rates = two_bags(folder, size, tuple(TOPICS))
    yield {"merge": rates, "memory": Pair(max(memory, of_merge))}
    yield {"small": two_bags(folder, size / 16, ("/odom",))[1]}
