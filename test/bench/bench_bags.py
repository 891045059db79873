"""Recorder and replay under load: losses, cost of a message, lateness of replay."""

from __future__ import annotations

import os
import re
import signal
import sys
import tempfile
import time
from pathlib import Path

import graph

RECORDER, REPLAY = "diffbot_bag.recorder_node", "diffbot_bag.replay_node"
DEPTH = 10_000
SECONDS = 5.0


def cpu(pid: int) -> float:
    """CPU time [s] that a process has used."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def record(folder: Path, topics: int, rate: float, count: int) -> str:
    """Record ``count`` rounds of one Odometry a topic, ``rate`` [Hz] rounds a second (0: as fast as it goes)."""
    from nav_msgs.msg import Odometry

    parameters = {"uri": folder, "regex": "/bench_.*"}
    with graph.peer() as peer, graph.node(RECORDER, parameters) as running:
        publishers = [peer.publisher(Odometry, f"/bench_{index}", DEPTH) for index in range(topics)]
        peer.wait_for_subscribers(*publishers)
        time.sleep(0.5)
        message, before, begin = Odometry(), cpu(running.popen.pid), time.perf_counter()
        for index in range(count):
            for publisher in publishers:
                publisher.publish(message)
            if rate > 0.0:
                time.sleep(max(0.0, begin + (index + 1) / rate - time.perf_counter()))
        took = time.perf_counter() - begin
        time.sleep(1.0)
        used = cpu(running.popen.pid) - before
        running.stop(signal.SIGINT)
        recorded, lost = map(int, re.search(r"(\d+) messages, (\d+) lost", running.output).groups())
    sent = topics * count
    size = sum(path.stat().st_size for path in folder.glob("*.mcap"))
    return (
        f"{sent} messages in {took:.2f} s: {recorded} recorded, {lost} lost, {1e6 * used / sent:.0f} us CPU and "
        f"{size / sent:.0f} bytes a message"
    )


def replay(folder: Path, rate: float) -> str:
    """Replay one Twist topic of ``rate`` [Hz] to a subscriber and return the node's own measure of lateness."""
    from geometry_msgs.msg import Twist
    from rclpy.serialization import serialize_message

    from diffbot_bag.qos import Qos
    from diffbot_bag.writer import BagWriter

    writer = BagWriter(folder)
    channel = writer.add_topic("/bench", "geometry_msgs/msg/Twist", [Qos()])
    data = bytes(serialize_message(Twist()))
    for index in range(int(rate * SECONDS)):
        stamp = 1_700_000_000_000_000_000 + round(index * 1e9 / rate)
        writer.write(channel, data, stamp, stamp)
    writer.close()
    with graph.peer() as peer, graph.node(REPLAY, {"uri": folder, "wait_timeout": 10.0}) as running:
        received = peer.subscribe(Twist, "/bench", DEPTH, raw=True)
        begin = cpu(running.popen.pid)
        used = begin

        def ended() -> bool:
            nonlocal used
            if running.popen.poll() is not None:
                return True
            used = cpu(running.popen.pid)
            return False

        peer.spin_until(ended, 60.0, "the end of the replay")
        peer.spin_until_quiet()
        late = re.search(r"late: (.*)", running.output)[1]
    return (
        f"{len(received)} of {int(rate * SECONDS)} received; late: {late}; {100 * (used - begin) / SECONDS:.0f} % CPU"
    )


def main() -> int:
    """Measure and print."""
    os.environ.update(ROS_DOMAIN_ID=str(graph.free_domain()), ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST")
    print(f"load of the machine: {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        lines = {
            "record, burst on one topic": lambda: record(folder / "burst", 1, 0.0, 5000),
            "record, 9 topics at 1000 Hz": lambda: record(folder / "nine", 9, 1000.0, int(1000 * SECONDS)),
            "replay, 100 Hz": lambda: replay(folder / "slow", 100.0),
            "replay, 1 kHz": lambda: replay(folder / "fast", 1000.0),
            "replay, 5 kHz": lambda: replay(folder / "faster", 5000.0),
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
