"""Replay: lateness and order at 1 kHz, ten times as fast, as fast as it is acknowledged, and seeks to single messages.

Targets, on a machine that does nothing else: at 1 kHz every message in order, late p50 <= 0.1 ms and p99 <= 4 ms; every
seek exact to the message; as many messages at ten times the rate.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import random
import re
import struct
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import graph
from bag_makers import BEGIN, point
from replays import MS, write_mcap

REPLAY = "diffbot_bag.replay_node"
DEPTH = 200_000
P50, P99 = 0.1, 4.0
"""[ms] targets of lateness at 1 kHz"""
TIMEOUT = 120.0
QUICK, FULL = (2000, 10), (20_000, 100)
"""messages, seeks"""


@contextlib.contextmanager
def receiving(bag: Path, **parameters: object) -> Iterator[tuple[graph.Peer, graph.Process, list[int]]]:
    """Run a replay; yield the node of this process, the replay and the numbers of the messages received so far."""
    from geometry_msgs.msg import Point
    from rclpy.qos import HistoryPolicy, QoSProfile

    received: list[int] = []
    qos = QoSProfile(depth=DEPTH, history=HistoryPolicy.KEEP_LAST)
    given = {"uri": bag, "wait_timeout": 20.0, "wait_acked_timeout": 60.0, **parameters}
    with graph.peer() as peer:
        peer.node.create_subscription(
            Point, "/a", lambda data: received.append(round(struct.unpack_from("<d", data, 4)[0])), qos, raw=True
        )
        with graph.node(REPLAY, given) as running:
            yield peer, running, received


def play(bag: Path, count: int, **parameters: object) -> tuple[str, str]:
    """Play to the end; return what was received, in words, and the last line of the log."""
    with receiving(bag, **parameters) as (peer, running, received):
        peer.spin_until(lambda: running.popen.poll() is not None, TIMEOUT, "the end of the replay")
        peer.spin_until_quiet(0.5)
        line = next(line for line in reversed(running.output.splitlines()) if " messages in " in line)
    order = "in order" if received == sorted(set(received)) else "OUT OF ORDER"
    return f"{len(received)} of {count} received, {order}", line.partition(": ")[2]


def in_time(bag: Path, count: int) -> str:
    """Measure lateness at 1 kHz."""
    words, line = play(bag, count)
    median, high = (float(text) for text in re.search(r"median ([\d.]+) us, 99 % within ([\d.]+) ms", line).groups())
    met = "met" if median / 1e3 <= P50 and high <= P99 else "MISSED"
    return f"{words}; late: p50 {median / 1e3:.3f} ms, p99 {high:.2f} ms (target {P50} and {P99}: {met})"


def seeks(bag: Path, count: int, number: int) -> str:
    """Jump to single messages of a paused replay, one step each."""
    from rcl_interfaces.msg import Parameter
    from rcl_interfaces.srv import SetParameters
    from rclpy.parameter import Parameter as RosParameter

    def change(peer: graph.Peer, **values: object) -> None:
        parameters = [
            Parameter(name=name, value=RosParameter(name, value=value).get_parameter_value())
            for name, value in values.items()
        ]
        request = SetParameters.Request(parameters=parameters)
        results = peer.call(SetParameters, "/replay/set_parameters", request, TIMEOUT).results
        assert all(result.successful for result in results), results

    generator, exact, took = random.Random(1), 0, []
    with receiving(bag, start_paused=True) as (peer, _, received):
        for _ in range(number):
            target = generator.randrange(count)
            received.clear()
            began = time.perf_counter()
            change(peer, seek=target * MS / 1e9, burst=1)
            peer.spin_until(lambda: received, TIMEOUT, "the message of a seek")
            took.append(time.perf_counter() - began)
            exact += received == [target]
    median = 1e3 * sorted(took)[number // 2]
    return f"{exact} of {number} exact to the message; request to reception: median {median:.0f} ms"


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a tenth of the messages and seeks")
    count, number = QUICK if parser.parse_args().quick else FULL
    os.environ.update(ROS_DOMAIN_ID=str(graph.free_domain()), ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST")
    print(f"load of the machine: {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
    with tempfile.TemporaryDirectory() as scratch:
        bag = write_mcap(
            Path(scratch) / "run.mcap", [("/a", BEGIN + index * MS, point(index)) for index in range(count)]
        )
        lines: dict[str, Callable[[], str]] = {
            "1 kHz": lambda: in_time(bag, count),
            "1 kHz, 10 times as fast": lambda: "; ".join(play(bag, count, rate=10.0)),
            "as fast as acknowledged": lambda: "; ".join(play(bag, count, as_fast_as_possible=True)),
            "seek": lambda: seeks(bag, count, number),
        }
        for name, measure in lines.items():
            stdout, sys.stdout = sys.stdout, open(os.devnull, "w")  # noqa: SIM115 - outputs of the processes
            try:
                result = measure()
            finally:
                sys.stdout.close()
                sys.stdout = stdout
            print(f"{name}: {result}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
