"""The recorder at 8 kHz: messages missing, CPU time beside a bare raw subscriber, longest stall, and what splits do.

First both processes receive the same messages at the same time: eight topics of a robot with other numbers in each
message, and one latched text. The bare one has the same executor and QoS, and a callback that only counts. CPU time is
that of the process while messages are sent. One after the other would compare two loads of the machine, since messages
that arrive in a burst cost half as much as those that each wake the process.

Then the recorder receives them alone. Its *stall* is the longest time that the writing of one message keeps the node
from the next one; its *delay* the longest time between the reception of a message by DDS and the end of its writing. A
machine that does not give the process a core lengthens both.

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
from contextlib import ExitStack, redirect_stdout
from pathlib import Path
from typing import Any, NamedTuple

import graph

DEPTH = 10_000
MAX_BAG_SIZE = 4 * 2**20
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


def cpu(pid: int) -> float:
    """CPU time [s] that a process has used."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


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

    def __str__(self) -> str:
        """Return a line without the name of the process."""
        return (
            f"{self.sent} messages in {self.seconds:.2f} s ({self.sent / self.seconds:.0f} Hz),"
            f" {self.received} received,"
            f" {1e6 * self.used / self.sent:.1f} us CPU a message, {100 * self.used / self.seconds:.0f} % of a core"
        )


def send(peer: Any, receivers: list[Any], seconds: float, rate: float) -> tuple[int, float, list[float]]:
    """Publish ``rate`` [Hz] messages altogether; return their number, the time [s], the receivers' CPU time [s]."""
    from rclpy.serialization import serialize_message

    publishers = [peer.publisher(kind, f"/bench_{index}", DEPTH) for index, kind in enumerate(kinds())]
    peer.wait_for_subscribers(*publishers, count=len(receivers), timeout=30.0)
    peer.spin_for(2.0)  # so that discovery and questions for parameters are over
    filled = [bytearray(serialize_message(kind())) for kind in kinds()]
    rounds = int(seconds * rate / len(publishers))
    before, begin = [cpu(one.popen.pid) for one in receivers], time.perf_counter()
    for index in range(rounds):
        for publisher, data in zip(publishers, filled, strict=True):
            data[-40:] = os.urandom(40)
            publisher.publish(bytes(data))
        if (left := begin + (index + 1) * len(publishers) / rate - time.perf_counter()) > 0.0:
            time.sleep(left)
    took = time.perf_counter() - begin
    peer.spin_for(3.5)  # a message that shared memory dropped is sent again after at most 3 s
    used = [cpu(one.popen.pid) - start for one, start in zip(receivers, before, strict=True)]
    return rounds * len(publishers), took, used


def bare_process() -> Any:
    """Return the bare subscriber, to be run in a ``with`` statement."""
    environment = graph.environment()
    folders = (environment["PYTHONPATH"], str(Path(__file__).parent), str(Path(graph.__file__).parent))
    environment["PYTHONPATH"] = os.pathsep.join(folders)
    return graph.process(sys.executable, "-c", BARE.format(depth=DEPTH), env=environment)


def measure(folder: Path, seconds: float, rate: float, with_bare: bool) -> tuple[list[Run], float, float]:
    """Let the recorder write the messages to ``folder``; return the runs of all processes, stall and delay [s]."""
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
        sent, took, used = send(peer, receivers, seconds, rate)
        counts = []
        for one in receivers:
            one.stop(signal.SIGINT, timeout=60.0)
            counts.append(int(re.findall(r"(\d+) messages", one.output)[-1]))
        counts[0] -= 1  # the latched text
        stall, delay = (float(graph.values(reports[-1])[key]) for key in ("stall", "delay"))
    runs = [Run(sent, took, count, each) for count, each in zip(counts, used, strict=True)]
    return runs, stall, delay


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
        together, alone = Path(scratch) / "together", Path(scratch) / "alone"
        with open(os.devnull, "w") as null, redirect_stdout(null):  # outputs of the processes
            (recorder, bare), _, _ = measure(together, seconds, options.rate, with_bare=True)
            (single,), stall, delay = measure(alone, seconds, options.rate, with_bare=False)
        for name, run in (("bare", bare), ("recorder", recorder), ("recorder alone", single)):
            print(f"{name}: {run}")
        print(f"CPU time: {recorder.used / bare.used:.2f} times that of the bare subscriber; target <= 1.25")
        print(f"alone: longest stall {1e3 * stall:.1f} ms; target <= 10 ms; longest delay {1e3 * delay:.0f} ms")
        for folder in (together, alone):
            print(f"bag: {verify(folder)}; target: 0 missing, 0 twice, the latched one in all files")
    return 0


if __name__ == "__main__":
    sys.exit(main())
