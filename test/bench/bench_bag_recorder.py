"""The recorder at 8 kHz: messages missing, CPU time beside a bare raw subscriber, longest stall, and what splits do.

Both processes in turn receive the same: eight topics of a robot with other numbers in each message, and one latched
text. The bare one has the same executor and QoS, and a callback that only counts. CPU time is that of the process while
messages are sent. A *stall* is the longest time between the reception of a message by DDS and the end of its writing by
the node, for any message of the run; a machine that does not give the process a core lengthens it as much as the node
does.

    python test/bench/bench_bag_recorder.py [--quick] [--seconds 20] [--rate 8000]
"""

from __future__ import annotations

import argparse
import os
import re
import signal
import sys
import tempfile
import time
from collections import defaultdict
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any, NamedTuple

import graph
from bench_bags import cpu

DEPTH = 10_000
MAX_BAG_SIZE = 2**20
"""[bytes] so that a run has several files"""
BARE = """
import sys, time
import rclpy
from bench_bag_recorder import kinds
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
print("ready", flush=True)
while not stop.is_set:
    executor.spin_once(timeout_sec=0.05)
print(f"{{count}} messages", flush=True)
"""


def kinds() -> list[Any]:
    """Return the types of the topics, those of a robot that drives: 300 bytes in the mean."""
    from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, Twist, TwistStamped
    from nav_msgs.msg import Odometry
    from sensor_msgs.msg import Imu, JointState

    return [Odometry, Odometry, PoseWithCovarianceStamped, PoseStamped, Twist, TwistStamped, JointState, Imu]


class Run(NamedTuple):
    """What one process did with the messages sent."""

    sent: int
    seconds: float
    received: int
    used: float
    """[s] CPU time"""
    stall: float
    """[s]; negative if it is not known"""

    @property
    def per_message(self) -> float:
        """CPU time of a message [us]."""
        return 1e6 * self.used / self.sent


def send(peer: Any, running: Any, seconds: float, rate: float) -> tuple[int, float, float]:
    """Publish ``rate`` [Hz] messages altogether; return their number, the time [s], and the receiver's CPU time [s]."""
    from rclpy.serialization import serialize_message

    publishers = [peer.publisher(kind, f"/bench_{index}", DEPTH) for index, kind in enumerate(kinds())]
    peer.wait_for_subscribers(*publishers)
    peer.spin_for(2.0)  # so that discovery and questions for parameters are over
    filled = [bytearray(serialize_message(kind())) for kind in kinds()]
    rounds = int(seconds * rate / len(publishers))
    before, begin = cpu(running.popen.pid), time.perf_counter()
    for index in range(rounds):
        for publisher, data in zip(publishers, filled, strict=True):
            data[-40:] = os.urandom(40)
            publisher.publish(bytes(data))
        if (left := begin + (index + 1) * len(publishers) / rate - time.perf_counter()) > 0.0:
            time.sleep(left)
    took = time.perf_counter() - begin
    peer.spin_for(3.5)  # a message that shared memory dropped is sent again after at most 3 s
    return rounds * len(publishers), took, cpu(running.popen.pid) - before


def run_bare(seconds: float, rate: float) -> Run:
    """Let a bare subscriber receive the messages."""
    code, environment = BARE.format(depth=DEPTH), graph.environment()
    environment["PYTHONPATH"] += os.pathsep + str(Path(__file__).parent) + os.pathsep + str(Path(graph.__file__).parent)
    with graph.peer() as peer, graph.process(sys.executable, "-c", code, env=environment) as running:
        running.wait_for_output("ready")
        sent, took, used = send(peer, running, seconds, rate)
        running.stop(signal.SIGINT)
        (received,) = re.findall(r"(\d+) messages", running.output)
    return Run(sent, took, int(received), used, -1.0)


def run_recorder(folder: Path, seconds: float, rate: float, **parameters: Any) -> Run:
    """Let the recorder write the messages to ``folder``."""
    from diagnostic_msgs.msg import DiagnosticStatus
    from std_msgs.msg import String

    from diffbot_core.ros.qos import LATCHED

    values = {"uri": folder, "regex": "/bench_.*", "max_bag_size": MAX_BAG_SIZE, **parameters}
    with graph.peer() as peer, graph.node("diffbot_bag.recorder_node", values) as running:
        latched = peer.publisher(String, "/bench_latched", LATCHED)
        latched.publish(String(data="of every file"))
        reports = peer.subscribe(DiagnosticStatus, "/recorder/status", LATCHED)
        sent, took, used = send(peer, running, seconds, rate)
        running.stop(signal.SIGINT, timeout=60.0)
        received = int(re.search(r"(\d+) messages, \d+ lost", running.output)[1])
        stall = float(graph.values(reports[-1])["stall"])
    return Run(sent, took, received - 1, used, stall)


def verify(folder: Path) -> str:
    """Compare the bag with what was sent, by the sequence numbers as mcap's own reader shows them."""
    from mcap.reader import make_reader

    numbers = defaultdict(list)
    files = sorted(folder.glob("*.mcap"), key=lambda path: int(path.stem.rpartition("_")[2]))
    for path in files:
        with path.open("rb") as stream:
            for _, channel, message in make_reader(stream).iter_messages():
                numbers[channel.topic].append(message.sequence)
    latched = numbers.pop("/bench_latched", [])
    gaps = sum(max(each) - len(set(each)) for each in numbers.values())
    twice = sum(len(each) - len(set(each)) for each in numbers.values())
    return f"{len(files)} files; {gaps} missing, {twice} twice; latched message in {len(latched)} files"


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="five seconds")
    parser.add_argument("--seconds", type=float, default=20.0, help="duration of each run [s]")
    parser.add_argument("--rate", type=float, default=8000.0, help="messages a second, of all topics together")
    options = parser.parse_args()
    seconds = 5.0 if options.quick else options.seconds
    os.environ.update(ROS_DOMAIN_ID=str(graph.free_domain()), ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST")
    print(f"load of the machine: {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "bag"
        with open(os.devnull, "w") as null, redirect_stdout(null):  # outputs of the processes
            bare = run_bare(seconds, options.rate)
            recorder = run_recorder(folder, seconds, options.rate)
        for name, run in (("bare", bare), ("recorder", recorder)):
            print(
                f"{name}: {run.sent} messages in {run.seconds:.2f} s ({run.sent / run.seconds:.0f} Hz),"
                f" {run.received} received, {run.per_message:.1f} us CPU a message,"
                f" {100 * run.used / run.seconds:.0f} % of a core"
            )
        print(f"CPU time: {recorder.used / bare.used:.2f} times that of the bare subscriber; target <= 1.25")
        print(f"longest stall: {1e3 * recorder.stall:.1f} ms; target <= 10 ms")
        print(f"bag: {verify(folder)}; target: 0 missing, 0 twice, the latched one in all files")
    return 0


if __name__ == "__main__":
    sys.exit(main())
