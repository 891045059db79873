"""Repair of bags: after kill -9 of a recorder, of cut and flipped files, and its speed and memory.

``PYTHONPATH=test/support python test/bench/bench_bag_tools.py [--quick]``
"""

from __future__ import annotations

import argparse
import io
import os
import random
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import bag_makers
import damaged_bags
import graph
from mcap.exceptions import McapError
from mcap.records import Channel, Message, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import Writer
from tqdm import tqdm

from diffbot_bag.reader import BagReader
from diffbot_bag.tools.repair import repair_bag
from diffbot_bag.writer import BagWriter
from diffbot_core.errors import DiffbotError

RECORDER = "diffbot_bag.recorder_node"
TOPICS, RATE = 8, 1000.0
"""Topics, and messages [Hz] on each."""
FLUSH = 0.5
"""[s]"""
MEMORY_PROGRAM = """
import sys
from pathlib import Path
from diffbot_bag.tools.repair import repair_bag
repair_bag(Path(sys.argv[1]), Path(sys.argv[2]))
# Not ru_maxrss, which begins with that of the process that started this one.
print(Path("/proc/self/status").read_text().partition("VmHWM:")[2].split()[0])
"""


def killed_recorder(folder: Path, generator: random.Random) -> tuple[bool, float]:
    """Kill a recorder at a random moment; return if its repaired bag has no gap, and the time [s] lost at the end."""
    from geometry_msgs.msg import Twist

    parameters = {"uri": folder / "run", "regex": "/bench_.*", "flush_period": FLUSH}
    sent: list[int] = []
    with graph.peer() as peer, graph.node(RECORDER, parameters) as running:
        publishers = [peer.publisher(Twist, f"/bench_{index}", 10_000) for index in range(TOPICS)]
        running.wait_for_output("ready", 60.0)
        peer.wait_for_subscribers(*publishers, timeout=60.0)
        message, begin = Twist(), time.perf_counter()
        until = generator.uniform(0.2, 2.5)
        while (now := time.perf_counter() - begin) < until:
            message.linear.x = float(len(sent))
            sent.append(time.time_ns())
            for publisher in publishers:
                publisher.publish(message)
            time.sleep(max(0.0, len(sent) / RATE - now))
        end = time.time_ns()
        running.popen.kill()
        running.wait()
    repair_bag(folder / "run", folder / "fixed")
    with BagReader(folder / "fixed") as reader:
        found: dict[str, list[float]] = {}
        for one in reader.decoded():
            found.setdefault(one.topic, []).append(one.content.linear.x)
        last = reader.end or sent[0]
    # What was recorded has no gap up to the last message: only the end is missing.
    whole = all(numbers == [numbers[0] + index for index in range(len(numbers))] for numbers in found.values())
    return whole, (end - last) * 1e-9


def kills(count: int, folder: Path) -> str:
    """Repair bags of killed recorders."""
    generator, lost, whole, repaired = random.Random(1), [], 0, 0
    for number in tqdm(range(count), "kill -9", disable=None):
        stdout, sys.stdout = sys.stdout, io.StringIO()  # outputs of the processes
        try:
            is_whole, seconds = killed_recorder(folder / str(number), generator)
            whole, repaired = whole + is_whole, repaired + 1
            lost.append(seconds)
        except DiffbotError as error:
            print(error, file=sys.stderr)
        finally:
            sys.stdout = stdout
    return (
        f"{repaired} of {count} repaired, {whole} without a gap; lost at the end: median"
        f" {statistics.median(lost):.2f} s, most {max(lost):.2f} s (flush period {FLUSH} s)"
    )


def damaged_files(count: int, folder: Path) -> str:
    """Repair cut and flipped files; count those from which a message of an undamaged chunk is missing."""
    generator = random.Random(2)
    wholes = [damaged_bags.original(damaged_bags.mcap_file(name)) for name in bag_makers.COMPRESSIONS]
    kept_messages = saved_messages = incomplete = wrong = unverified = refused = 0
    folder.mkdir()
    for number in tqdm(range(count), "cut or flipped", disable=None):
        whole = wholes[number % len(wholes)]
        content, changed, cut = damaged_bags.damage(whole, generator)
        (folder / "broken.mcap").write_bytes(content)
        shutil.rmtree(folder / "fixed", ignore_errors=True)
        try:
            result = repair_bag(folder / "broken.mcap", folder / "fixed")
        except DiffbotError as error:
            refused += 1
            print(error, file=sys.stderr)
            continue
        saved = _data(damaged_bags.messages_of((folder / "fixed" / "fixed_0.mcap").read_bytes()))
        kept = _data(damaged_bags.surviving(whole, changed, cut))
        kept_messages, saved_messages = kept_messages + kept.total(), saved_messages + saved.total()
        incomplete += not saved >= kept
        if not saved <= _data(whole.messages):
            # Damage within the incomplete last chunk cannot be detected: its messages are reported as unverified.
            reported = result.files[0].salvaged.loss.unverified >= (saved - _data(whole.messages)).total()
            wrong, unverified = wrong + (not reported), unverified + reported
    return (
        f"{count - refused} of {count} repaired, {incomplete} without a message of an undamaged chunk, {wrong} with a"
        f" message that is not in the original ({unverified} more among those reported"
        f" as unverified); {kept_messages} messages in undamaged chunks, {saved_messages} saved"
    )


def _data(messages: Counter[tuple[object, ...]]) -> Counter[tuple[object, ...]]:
    """Without the topic, which nothing may describe any more."""
    found: Counter[tuple[object, ...]] = Counter()
    for message, count in messages.items():
        found[message[1:]] += count
    return found


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


def copy_by_mcap(source: Path, target: Path) -> None:
    """Copy message by message, as far as the mcap library reads."""
    writer = Writer(str(target))
    writer.start("ros2")
    schemas: dict[int, int] = {}
    channels: dict[int, int] = {}
    try:
        for record in StreamReader(str(source)).records:
            if isinstance(record, Schema):
                schemas[record.id] = writer.register_schema(record.name, record.encoding, record.data)
            elif isinstance(record, Channel):
                schema = schemas[record.schema_id]
                channels[record.id] = writer.register_channel(record.topic, "cdr", schema, record.metadata)
            elif isinstance(record, Message):
                channel = channels[record.channel_id]
                writer.add_message(channel, record.log_time, record.data, record.publish_time, record.sequence)
    except (McapError, ValueError):
        pass
    writer.finish()


def speed(size: int, message_size: int, rounds: int, folder: Path) -> str:
    """Compare a repair with a copy by the mcap library, in CPU time: one after the other in each round."""
    source = unfinished_bag(folder / "run", size, message_size)
    megabytes, ratios, ours = source.stat().st_size / 2**20, [], []
    for number in tqdm(range(rounds), f"speed, {message_size} bytes", disable=None):
        times = []
        for work in (
            lambda: repair_bag(source, folder / f"fixed{number}"),  # noqa: B023 - called at once
            lambda: copy_by_mcap(source, folder / "copy.mcap"),
        ):
            begin = time.process_time()
            work()
            times.append(time.process_time() - begin)
        shutil.rmtree(folder / f"fixed{number}")
        ours.append(times[0])
        ratios.append(times[1] / times[0])
    return (
        f"{megabytes:.0f} MiB with messages of {message_size} bytes: {megabytes / statistics.median(ours):.0f} MiB/s of"
        f" CPU time, checked by two readers; {statistics.median(ratios):.2f} x the speed of copying by the mcap library"
    )


def memory(size: int, folder: Path) -> str:
    """Repair a large bag in a process of its own."""
    source = unfinished_bag(folder / "run", size, 4096)
    command = [sys.executable, "-c", MEMORY_PROGRAM, str(source), str(folder / "fixed")]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=3600)
    return f"{int(done.stdout) / 1024:.0f} MiB at most for {source.stat().st_size / 2**30:.2f} GiB"


def bench_repair(quick: bool, folder: Path) -> dict[str, str]:
    """Measure the repair; return lines by what they are about."""
    small = 2**24 if quick else 2**27
    found = {}
    for name, measure in {
        "kill -9 at 8 kHz": lambda: kills(2 if quick else 50, folder / "kills"),
        "cut or flipped files": lambda: damaged_files(30 if quick else 500, folder / "damaged"),
        "speed": lambda: speed(small // 4, 300, 3, folder / "speed300"),
        "speed, large messages": lambda: speed(small, 20_000, 3, folder / "speed20k"),
        "memory": lambda: memory(2**26 if quick else 2**31, folder / "memory"),
    }.items():
        found[name] = measure()
        print(f"repair, {name}: {found[name]}", flush=True)
    return found


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a few of each")
    options = parser.parse_args()
    os.environ.update(ROS_DOMAIN_ID=str(graph.free_domain()), ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST")
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    print(f"load of the machine: {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
    with tempfile.TemporaryDirectory() as scratch:
        bench_repair(options.quick, Path(scratch))
    return 0


if __name__ == "__main__":
    sys.exit(main())
