"""Measure the recorder at 8 kHz: its CPU time and that of a bare subscriber, missing messages, and the longest delay.

First, the recorder and a bare raw subscriber receive the same messages at the same time. The bare subscriber has the
same executor and QoS, and its callback only counts. Measuring one after the other would compare two loads of the
machine, since messages in a burst need half the CPU time of messages that each wake the process. Then only the recorder
receives the messages. Its *delay* is the longest time from the reception of a message by DDS until the message is
handed over to the writing thread.
"""

from __future__ import annotations

import os
import signal
import sys
import tempfile
import time
from collections import defaultdict
from pathlib import Path
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, Twist, TwistStamped
from mcap.reader import make_reader
from nav_msgs.msg import Odometry
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.serialization import serialize_message
from rclpy.signals import SignalHandlerOptions
from rounds import Table, cpu_seconds, is_quick, start
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import String
from tqdm import tqdm

from diffbot_core.ros.qos import LATCHED
from diffbot_core.ros.run import StopFlag, make_executor
from diffbot_tools.processes import PrivateDomain, graph_environment

KINDS = (Odometry, Odometry, PoseWithCovarianceStamped, PoseStamped, Twist, TwistStamped, JointState, Imu)
"""Message types of a typical robot, with a mean of 300 bytes per message."""
RATE = 8000.0
"""[Hz] of all topics together"""
DEPTH = 10_000
MAX_BAG_SIZE = 4 * 2**20
"""[bytes] small enough that a run has several files"""
ROUNDS, SECONDS = 3, 8.0
_TIMEOUT = 60.0
"""[s] for discovery, acknowledgement and the end of a process"""


def run_bare() -> None:
    """Count the messages until SIGINT. This is the reference process."""
    stop = StopFlag()
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node, count = Node("bare"), 0

    def add(_data: bytes) -> None:
        nonlocal count
        count += 1

    for index, kind in enumerate(KINDS):
        node.create_subscription(kind, f"/bench_{index}", add, DEPTH, raw=True)
    executor = make_executor()
    executor.add_node(node)
    while not stop.is_set:
        executor.spin_once(timeout_sec=0.05)


class Sender:
    """The node that publishes the messages and receives the recorder's status."""

    def __init__(self) -> None:
        self.context = rclpy.Context()
        rclpy.init(context=self.context)
        self.node = Node("sender", context=self.context, start_parameter_services=False)
        self.executor = rclpy.executors.SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.reports: list[DiagnosticStatus] = []
        self.node.create_subscription(DiagnosticStatus, "/recorder/status", self.reports.append, LATCHED)
        self.publishers = [
            self.node.create_publisher(kind, f"/bench_{index}", DEPTH) for index, kind in enumerate(KINDS)
        ]
        self.node.create_publisher(String, "/bench_latched", LATCHED).publish(String(data="latched"))

    def spin_for(self, seconds: float) -> None:
        """Handle callbacks for a while."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0.0:
            self.executor.spin_once(timeout_sec=left)

    def send(self, processes: list[Any], seconds: float) -> tuple[int, list[float]]:
        """Publish the messages; return their number, and the CPU time [s] of each of the processes."""
        deadline = time.monotonic() + _TIMEOUT
        while any(one.get_subscription_count() < len(processes) for one in self.publishers):
            if time.monotonic() > deadline:
                raise SystemExit(f"not all subscribers were discovered within {_TIMEOUT:g} s")
            self.spin_for(0.05)
        self.spin_for(min(2.0, seconds))  # until discovery and the requests for parameters have ended
        filled = [bytearray(serialize_message(kind())) for kind in KINDS]
        rounds = int(seconds * RATE / len(KINDS))
        before, begin = [cpu_seconds([one]) for one in processes], time.perf_counter()
        for index in range(rounds):
            for publisher, data in zip(self.publishers, filled, strict=True):
                data[-40:] = os.urandom(40)
                publisher.publish(bytes(data))
            if (left := begin + (index + 1) * len(KINDS) / RATE - time.perf_counter()) > 0.0:
                time.sleep(left)
        # DDS sends a lost message again, which takes seconds.
        for publisher in self.publishers:
            publisher.wait_for_all_acked(Duration(seconds=_TIMEOUT))
        self.spin_for(0.5)
        used = [cpu_seconds([one]) - first for one, first in zip(processes, before, strict=True)]
        return rounds * len(KINDS), used

    def close(self) -> None:
        """Leave the graph."""
        self.executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()


def run(folder: Path, seconds: float, *, with_bare: bool) -> tuple[int, list[float], dict[str, float]]:
    """Record the messages; return their number, the CPU times [s], and the figures of the recording."""
    words = {"uri": folder / "bag", "regex": "/bench_.*", "max_bag_size": MAX_BAG_SIZE}
    parameters = [word for name, value in words.items() for word in ("-p", f"{name}:={value}")]
    commands = [["-m", "diffbot_bag.recorder_node", "--ros-args", *parameters]]
    commands += [[__file__, "bare"]] if with_bare else []
    processes, sender = [], Sender()
    try:
        for number, command in enumerate(commands):
            processes.append(start(command, dict(os.environ), folder / f"{number}.log"))
        sent, used = sender.send(processes, seconds)
        status = {pair.key: pair.value for pair in sender.reports[-1].values}
    finally:
        for process in processes:
            process.send_signal(signal.SIGINT)
        for process in processes:
            process.communicate(timeout=_TIMEOUT)
        sender.close()
    wrong, unlatched = verify(folder / "bag", sent)
    return sent, used, {"delay": 1e3 * float(status["delay"]), "wrong": wrong, "unlatched": unlatched}


def verify(folder: Path, sent: int) -> tuple[int, int]:
    """Return the number of messages that are missing or duplicated, and of files without the latched message.

    They are counted by the sequence numbers that mcap's reader returns.
    """
    numbers, files = defaultdict(list), list(folder.glob("*.mcap"))
    for path in files:
        with path.open("rb") as stream:
            for _, channel, message in make_reader(stream).iter_messages():
                numbers[channel.topic].append(message.sequence)
    latched = len(numbers.pop("/bench_latched", []))
    once = sum(len(set(each)) for each in numbers.values())
    twice = sum(len(each) for each in numbers.values()) - once
    return abs(sent - once) + twice, abs(len(files) - latched)


def main() -> None:
    """Measure, and print the table; exit status 1 if a message was lost."""
    if sys.argv[1:] == ["bare"]:
        run_bare()
        return
    quick, table, domain = is_quick(__doc__.splitlines()[0]), Table(), PrivateDomain()
    os.environ |= graph_environment(domain.id)
    wrong = 0.0
    for _ in tqdm(range(1 if quick else ROUNDS), "recorder", unit=" rounds", leave=False, disable=None):
        for with_bare in (True, False):
            with tempfile.TemporaryDirectory(prefix="diffbot-bench-") as folder:
                os.environ["ROS_LOG_DIR"] = folder
                sent, used, found = run(Path(folder), 1.0 if quick else SECONDS, with_bare=with_bare)
            if with_bare:
                table.add("CPU time per message; reference: bare subscriber [us]", *(1e6 * one / sent for one in used))
            else:
                table.add("longest delay from reception to the writing thread [ms]", found["delay"])
            table.add("missing or duplicated messages", found["wrong"])
            table.add("files without the latched message", found["unlatched"])
            wrong += found["wrong"] + found["unlatched"]
    domain.release()
    table.show()
    raise SystemExit(int(wrong > 0.0))


if __name__ == "__main__":
    main()
