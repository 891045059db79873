"""Replay: lateness and order at 1 kHz, ten times as fast, as fast as it is acknowledged, and seeks."""

from __future__ import annotations

import contextlib
import itertools
import random
import re
import struct
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import graph
from bag_makers import BEGIN, point
from measures import OURS, Measure, Pair
from replays import MS, write_mcap

DEPTH = 200_000
TIMEOUT = 120.0
MESSAGES, SEEKS = 20_000, 100
QUICK_MESSAGES, QUICK_SEEKS = 500, 3
MEASURES = (
    Measure("median", "1 kHz: lateness, median", "ms", OURS, at_most=0.1),
    Measure("p99", "1 kHz: lateness, p99", "ms", OURS, at_most=4.0),
    Measure("wrong", "messages missing, twice or out of order, all modes", "", OURS, at_most=0.0),
    Measure("tenfold", "ten times as fast: messages received", "/s"),
    Measure("acknowledged", "as_fast_as_possible: messages received", "/s"),
    Measure("inexact", "seeks that did not give their message", "", OURS, at_most=0.0),
    Measure("seek", "seek of a paused replay: request to reception, median", "ms"),
)


@contextlib.contextmanager
def receiving(bag: Path, **parameters: object) -> Iterator[tuple[Any, Any, list[int], list[float]]]:
    """Run a replay; yield the node of this process, the replay, numbers and times of the messages received."""
    from geometry_msgs.msg import Point
    from rclpy.qos import HistoryPolicy, QoSProfile

    received: list[int] = []
    times: list[float] = []

    def receive(data: bytes) -> None:
        received.append(round(struct.unpack_from("<d", data, 4)[0]))
        times.append(time.perf_counter())

    qos = QoSProfile(depth=DEPTH, history=HistoryPolicy.KEEP_LAST)
    given = {"uri": bag, "wait_timeout": 20.0, "wait_acked_timeout": 60.0, **parameters}
    with graph.peer() as peer:
        peer.node.create_subscription(Point, "/a", receive, qos, raw=True)
        with graph.node("diffbot_bag.replay_node", given) as running:
            yield peer, running, received, times


class Played(NamedTuple):
    """A replay to the end."""

    wrong: int
    """messages missing, twice or before an earlier one"""
    rate: float
    """[1/s] from the first to the last message received"""
    line: str
    """what the replay says at its end"""


def play(bag: Path, count: int, **parameters: object) -> Played:
    """Play to the end."""
    with receiving(bag, **parameters) as (peer, running, received, times):
        peer.spin_until(lambda: running.popen.poll() is not None, TIMEOUT, "the end of the replay")
        peer.spin_until_quiet(0.5)
        # Each message has a time of its own: where the reader was held up, all may have come at once.
        rate = (len(times) - 1) / (times[-1] - times[0])
        line = next(line for line in reversed(running.output.splitlines()) if " messages in " in line)
    late = sum(later <= earlier for earlier, later in itertools.pairwise(received))
    return Played(late + abs(count - len(set(received))), rate, line)


def seeks(bag: Path, count: int, number: int) -> dict[str, Pair]:
    """Jump to single messages of a paused replay, one step each."""
    from rcl_interfaces.msg import Parameter
    from rcl_interfaces.srv import SetParameters
    from rclpy.parameter import Parameter as RosParameter

    def change(peer: Any, **values: object) -> None:
        parameters = [
            Parameter(name=name, value=RosParameter(name, value=value).get_parameter_value())
            for name, value in values.items()
        ]
        request = SetParameters.Request(parameters=parameters)
        results = peer.call(SetParameters, "/replay/set_parameters", request, TIMEOUT).results
        assert all(result.successful for result in results), results

    generator, inexact, took = random.Random(1), 0, []
    with receiving(bag, start_paused=True) as (peer, _, received, _):
        # An empty request first: DDS may drop a first answer, and a repeated seek would publish its message twice.
        change(peer)
        for _ in range(number):
            target = generator.randrange(count)
            received.clear()
            began = time.perf_counter()
            change(peer, seek=target * MS / 1e9, burst=1)
            peer.spin_until(lambda: received, TIMEOUT, "the message of a seek")
            took.append(time.perf_counter() - began)
            inexact += received != [target]
    return {"inexact": Pair(inexact), "seek": Pair(1e3 * sorted(took)[number // 2])}


def measure(quick: bool, folder: Path) -> Iterator[dict[str, Pair]]:
    """Yield the figures of each mode."""
    count, number = (QUICK_MESSAGES, QUICK_SEEKS) if quick else (MESSAGES, SEEKS)
    bag = write_mcap(folder / "run.mcap", [("/a", BEGIN + index * MS, point(index)) for index in range(count)])
    in_time = play(bag, count)
    median, high = map(
        float,
        re.search(r"median ([\d.]+) us, 99 % within ([\d.]+) ms", in_time.line).groups(),  # type: ignore[union-attr]
    )
    yield {"median": Pair(median / 1e3), "p99": Pair(high)}
    tenfold, acknowledged = play(bag, count, rate=10.0), play(bag, count, as_fast_as_possible=True)
    yield {
        "tenfold": Pair(tenfold.rate),
        "acknowledged": Pair(acknowledged.rate),
        "wrong": Pair(in_time.wrong + tenfold.wrong + acknowledged.wrong),
    }
    yield seeks(bag, count, number)
