"""The recorder at 8 kHz: messages missing, CPU time beside a bare raw subscriber, longest stall, and what splits do.

First both processes receive the same messages at the same time. The bare one has the same executor and QoS, and a
callback that only counts; CPU time is that of the process while messages are sent. One after the other would compare
two loads of the machine, since messages that arrive in a burst cost half as much as those that each wake the process.
Then the recorder receives them alone. Its *stall* is the longest time that the writing of one message keeps the node
from the next one; its *delay* the longest time between the reception of a message by DDS and the end of its writing. A
machine that does not give the process a core lengthens both.
"""

from __future__ import annotations

import os
import signal
import sys
import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple

import graph
from chains import cpu_seconds
from measures import OURS, Measure, Pair

RATE = 8000.0
"""[Hz] of all topics together"""
DEPTH = 10_000
MAX_BAG_SIZE = 4 * 2**20
"""[bytes] so that a run has several files"""
ROUNDS, SECONDS = 3, 8.0
QUICK_SECONDS = 1.0
MEASURES = (
    Measure("cpu", "CPU time a message, beside a bare raw subscriber", "us", at_most=1.25),
    Measure("missing", "messages missing or recorded twice, all runs", "", OURS, at_most=0.0),
    Measure("latched", "files without the latched message", "", OURS, at_most=0.0),
    Measure("stall", "longest time that the writing of a message delayed the next one", "ms", OURS, at_most=10.0),
    Measure("delay", "longest time from reception to the end of writing", "ms"),
)
BARE = """
import rclpy
from part_recorder import kinds
from rclpy.node import Node
from diffbot_core.ros.node import StopFlag, make_executor
stop = StopFlag()
rclpy.init(signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
node = Node("bare")
count = 0
def counted(data):
    global count
    count += 1
for index, kind in enumerate(kinds()):
    node.create_subscription(kind, f"/bench_{{index}}", counted, {depth}, raw=True)
executor = make_executor()
executor.add_node(node)
while not stop.is_set:
    executor.spin_once(timeout_sec=0.05)
"""


def kinds() -> list[Any]:
    """Return the types of the topics, those of a robot that drives: 300 bytes in the mean."""
    from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, Twist, TwistStamped
    from nav_msgs.msg import Odometry
    from sensor_msgs.msg import Imu, JointState

    return [Odometry, Odometry, PoseWithCovarianceStamped, PoseStamped, Twist, TwistStamped, JointState, Imu]


class Run(NamedTuple):
    """What came of the messages sent."""

    sent: int
    used: list[float]
    """[s] CPU time of each receiver"""
    stall: float
    delay: float
    """[s] of the recorder"""
    wrong: int
    """messages that are not in the bag or twice"""
    unlatched: int
    """files without the latched message"""


def send(peer: Any, receivers: list[Any], seconds: float) -> tuple[int, list[float]]:
    """Publish the messages; return their number, and the receivers' CPU time [s]."""
    from rclpy.duration import Duration
    from rclpy.serialization import serialize_message

    publishers = [peer.publisher(kind, f"/bench_{index}", DEPTH) for index, kind in enumerate(kinds())]
    peer.wait_for_subscribers(*publishers, count=len(receivers))
    peer.spin_for(min(2.0, seconds))  # so that discovery and questions for parameters are over
    filled = [bytearray(serialize_message(kind())) for kind in kinds()]
    processes = [one.popen for one in receivers]
    rounds = int(seconds * RATE / len(publishers))
    before, begin = [cpu_seconds([one]) for one in processes], time.perf_counter()
    for index in range(rounds):
        for publisher, data in zip(publishers, filled, strict=True):
            data[-40:] = os.urandom(40)
            publisher.publish(bytes(data))
        if (left := begin + (index + 1) * len(publishers) / RATE - time.perf_counter()) > 0.0:
            time.sleep(left)
    # A message that was dropped on its way is sent again, after seconds.
    for publisher in publishers:
        publisher.wait_for_all_acked(Duration(seconds=graph.PATIENCE))
    peer.spin_for(0.5)
    used = [cpu_seconds([one]) - start for one, start in zip(processes, before, strict=True)]
    return rounds * len(publishers), used


def bare_process() -> Any:
    """Return the bare subscriber, to be run in a ``with`` statement."""
    environment = graph.environment()
    here, helpers = Path(__file__).parent, Path(graph.__file__).parent
    environment["PYTHONPATH"] = os.pathsep.join((environment["PYTHONPATH"], str(here), str(helpers)))
    return graph.process(sys.executable, "-c", BARE.format(depth=DEPTH), env=environment)


def run(folder: Path, seconds: float, with_bare: bool) -> Run:
    """Let the recorder write the messages to ``folder``."""
    from diagnostic_msgs.msg import DiagnosticStatus
    from std_msgs.msg import String

    from diffbot_core.ros.qos import LATCHED

    values = {"uri": folder, "regex": "/bench_.*", "max_bag_size": MAX_BAG_SIZE}
    with ExitStack() as stack:
        peer = stack.enter_context(graph.peer())
        receivers = [stack.enter_context(graph.node("diffbot_bag.recorder_node", values))]
        if with_bare:
            receivers.append(stack.enter_context(bare_process()))
        latched = peer.publisher(String, "/bench_latched", LATCHED)
        latched.publish(String(data="of every file"))
        reports = peer.subscribe(DiagnosticStatus, "/recorder/status", LATCHED)
        sent, used = send(peer, receivers, seconds)
        receivers[0].stop(signal.SIGINT)
        stall, delay = (float(graph.values(reports[-1])[key]) for key in ("stall", "delay"))
    return Run(sent, used, stall, delay, *verify(folder, sent))


def verify(folder: Path, sent: int) -> tuple[int, int]:
    """Compare the bag with what was sent, by the sequence numbers as mcap's own reader shows them."""
    from mcap.reader import make_reader

    numbers, files = defaultdict(list), list(folder.glob("*.mcap"))
    for path in files:
        with path.open("rb") as stream:
            for _, channel, message in make_reader(stream).iter_messages():
                numbers[channel.topic].append(message.sequence)
    latched = len(numbers.pop("/bench_latched", []))
    once = sum(len(set(each)) for each in numbers.values())
    twice = sum(len(each) for each in numbers.values()) - once
    return abs(sent - once) + twice, abs(len(files) - latched)


def measure(quick: bool, folder: Path) -> Iterator[dict[str, Pair]]:
    """Yield the CPU time of each round, at the end what holds for all runs."""
    seconds = QUICK_SECONDS if quick else SECONDS
    runs = []
    for number in range(1 if quick else ROUNDS):
        both = run(folder / f"both{number}", seconds, with_bare=True)
        yield {"cpu": Pair(*(1e6 * used / both.sent for used in both.used))}
        alone = both if quick else run(folder / f"alone{number}", seconds, with_bare=False)
        yield {"stall": Pair(1e3 * alone.stall), "delay": Pair(1e3 * alone.delay)}
        runs += [both, alone]
    yield {"missing": Pair(sum(one.wrong for one in runs)), "latched": Pair(sum(one.unlatched for one in runs))}
