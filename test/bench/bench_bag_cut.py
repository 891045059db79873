"""Trim, filter, merge and split of a bag of 2 GiB: time and memory of each command, beside the mcap library.

``python test/bench/bench_bag_cut.py``, with ``--quick`` on 64 MiB. The bag stands in a temporary folder and is deleted.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple

import numpy as np
from mcap.reader import make_reader
from mcap.records import Channel, Schema
from mcap.writer import Writer

from diffbot_bag.qos import Qos, dump_profiles
from diffbot_bag.tools.channels import Channels
from diffbot_bag.tools.cut import merge
from diffbot_bag.tools.output_bag import Description, OutputBag
from diffbot_bag.tools.source_bag import Row, SourceBag
from diffbot_bag.whole_chunk import DEFAULT_COMPRESSION

DIFFBOT = (sys.executable, "-m", "diffbot_lab.cli", "bag")
BEGIN = 1_700_000_000_000_000_000
TOPICS = {"/camera": (33_333_333, 100_000), "/odom": (1_000_000, 306), "/map": (10**11, 5000)}
"""Period [ns] and size [bytes] of the messages: 3.3 MB/s."""
MAX_TRIM_TIME, MIN_RATE, MIN_RATIO, MAX_MEMORY = 1.0, 150.0, 0.7, 200.0
"""Targets: [s], [MB/s], [-] of the mcap library's rate, [MB]."""


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


class Cost(NamedTuple):
    """What a command took."""

    wall: float
    """[s]"""
    cpu: float
    """[s]"""
    memory: float
    """[MB] at most"""


def run(*arguments: object) -> Cost:
    """Run ``diffbot bag`` in a process of its own."""
    begin = time.monotonic()
    with subprocess.Popen([*DIFFBOT, *map(str, arguments)], stdout=subprocess.DEVNULL) as child:
        _, status, used = os.wait4(child.pid, 0)
        child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode:
        raise SystemExit(f"diffbot bag {arguments[0]}: status {child.returncode}")
    return Cost(time.monotonic() - begin, used.ru_utime + used.ru_stime, used.ru_maxrss * 1024 / 1e6)


def copy_by_mcap(paths: Sequence[Path], out: Path) -> None:
    """Copy the files with the mcap library, in the order of log time, one after the other."""
    with out.open("wb") as target:
        writer = Writer(target)
        writer.start(profile="ros2")
        for path in paths:
            with path.open("rb") as source:
                known: dict[int, int] = {}
                for schema, channel, message in make_reader(source).iter_messages():
                    if channel.id not in known:
                        number = writer.register_schema(schema.name, schema.encoding, schema.data) if schema else 0
                        known[channel.id] = writer.register_channel(channel.topic, "cdr", number, channel.metadata)
                    number, data = known[channel.id], message.data
                    writer.add_message(number, message.log_time, data, message.publish_time, message.sequence)
        writer.finish()


def merge_here(paths: Sequence[Path], out: Path) -> None:
    """Merge in this process."""
    with ExitStack() as stack:
        merge([stack.enter_context(SourceBag(path)) for path in paths]).write(out, lambda count: None)


def cpu_of(work: Callable[[], None]) -> float:
    """CPU time [s] of some work in this process, which other processes do not lengthen."""
    begin = time.process_time()
    work()
    return time.process_time() - begin


def show(name: str, value: float, unit: str, target: str, kept: bool) -> None:
    """Print a figure beside its target."""
    print(f"{name}: {value:.2f} {unit} (target {target}{'' if kept else ': MISSED'})", flush=True)


def show_memory(name: str, cost: Cost) -> None:
    """Print the memory of a command."""
    show(f"{name}: memory", cost.memory, "MB", f"<= {MAX_MEMORY:g} MB", cost.memory <= MAX_MEMORY)


def bench_one_bag(folder: Path, size: float) -> None:
    """Trim, filter and split a bag."""
    bag, out = folder / "bag", folder / "out"
    seconds = write_bag(bag, size)
    print(f"a bag of {size_of(bag):.0f} MB, {seconds:.0f} s; load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
    middle = seconds / 2
    calls = {
        "trim of 10 s": ("trim", "--from", f"{middle:.3f}s", "--to", f"{middle + 10:.3f}s"),
        "filter of one topic": ("filter", "--topics", "/odom"),
        "split by duration": ("split", "--duration", f"{seconds / 7:.3f}s"),
    }
    for name, (verb, *flags) in calls.items():
        cost = run(verb, bag, out, *flags)
        what = f"{name}: {size_of(out):.0f} MB written, {cost.cpu:.2f} s CPU"
        if verb == "trim":
            show(what, cost.wall, "s", f"<= {MAX_TRIM_TIME:g} s", cost.wall <= MAX_TRIM_TIME)
        else:
            print(f"{what}, {cost.wall:.2f} s: {size_of(bag) / cost.wall:.0f} MB/s")
        show_memory(name, cost)
        shutil.rmtree(out)
    shutil.rmtree(bag)


def bench_merge(folder: Path, size: float, name: str, topics: Sequence[str]) -> None:
    """Merge two bags, interleaved, and copy an eighth of them with the mcap library."""
    a, b, out = (folder / one for one in ("a", "b", "out"))
    for part, share in ((a, 0), (b, 500_000)):
        write_bag(part, size / 2, topics, share)
    cost, total = run("merge", a, b, out), size_of(a, b)
    shutil.rmtree(out)
    shutil.rmtree(b)
    write_bag(b, size / 16, topics, 500_000)
    shutil.rmtree(a)
    write_bag(a, size / 16, topics)
    part = size_of(a, b)
    ours = part / cpu_of(lambda: merge_here([a, b], out))
    theirs = part / cpu_of(lambda: copy_by_mcap([a / "a_0.mcap", b / "b_0.mcap"], folder / "copy.mcap"))
    rate = total / cost.wall
    kept = rate >= MIN_RATE or ours >= MIN_RATIO * theirs
    target = f">= {MIN_RATE:g} MB/s or {MIN_RATIO:g} x the mcap library"
    show(f"merge, {name}: {total:.0f} MB in {cost.wall:.1f} s, {cost.cpu:.1f} s CPU", rate, "MB/s", target, kept)
    print(f"merge, {name}: {ours:.0f} MB a second of CPU; copied by the mcap library: {theirs:.0f}")
    show_memory(f"merge, {name}", cost)
    (folder / "copy.mcap").unlink()
    for one in (a, b, out):
        shutil.rmtree(one)


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="64 MiB instead of 2 GiB")
    size = 2**26 if parser.parse_args().quick else 2**31
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        if shutil.disk_usage(folder).free < 6 * size:
            print(f"{folder} has too little space: must be >= {6 * size / 1e9:.1f} GB", file=sys.stderr)
            return 1
        bench_one_bag(folder, size)
        bench_merge(folder, size, "all topics", tuple(TOPICS))
        bench_merge(folder, size / 16, "messages of 306 bytes", ("/odom",))
    return 0


if __name__ == "__main__":
    sys.exit(main())
