"""The graph of the soak: nodes that are killed, held up and sampled."""

import math
import os
import signal
import threading
import time
from pathlib import Path
from statistics import median_high

from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from scipy.stats import theilslopes

from diffbot_tools.demo.processes import NodeProcesses, PrivateDomain, graph_environment

START = (0.0, 0.0, 0.0)
WARM_UP = 60.0
"""[s] of a process that are not counted"""
MAX_SLOPE = 0.3
"""[MB/min] of a process's memory"""
SAMPLE_PERIOD = 2.0
MIN_SAMPLES = 20
NODES = {
    "controller": ("diffbot_control.controller_node", {}),
    "ekf": ("diffbot_control.ekf_node", {}),
    "plant": (
        "diffbot_sim.plant_node",
        {"initial_pose.x": START[0], "initial_pose.y": START[1], "initial_pose.yaw": START[2]},
    ),
}


def sample(pid):
    """Return memory [MB], threads and open descriptors of a process; None if it has ended."""
    try:
        status = dict(line.split(":", 1) for line in Path(f"/proc/{pid}/status").read_text().splitlines())
        descriptors = len(os.listdir(f"/proc/{pid}/fd"))
        return int(status["VmRSS"].split()[0]) / 1024.0, int(status["Threads"]), descriptors
    except (OSError, KeyError):
        return None


class Graph:
    """Plant, filter and controller on a private domain, each sampled by a thread while it lives."""

    def __init__(self, folder):
        """Prepare; logs go to ``folder``."""
        self._domain, self._folder = PrivateDomain(), folder
        os.environ |= graph_environment(self._domain.id)
        self._nodes = NodeProcesses(self._domain.id, folder)
        self._running, self._samples, self._begun = {}, {}, {}
        self._tracebacks = 0
        self._deaths = []
        self._ended = threading.Event()
        self._sampler = threading.Thread(target=self._sample, daemon=True)

    def __enter__(self):
        """Start the nodes."""
        self._nodes.__enter__()
        for name in NODES:
            self._start(name)
        self._sampler.start()
        return self

    def __exit__(self, *error):
        """Stop the nodes."""
        self._ended.set()
        self._sampler.join()
        self._nodes.__exit__(*error)
        self._domain.release()

    def _start(self, name):
        module, parameters = NODES[name]
        self._running[name] = self._nodes.start(name, module, parameters)
        self._begun[name], self._samples[name] = time.monotonic(), []

    def _sample(self):
        while not self._ended.wait(SAMPLE_PERIOD):
            for name, process in list(self._running.items()):
                found = sample(process.pid)
                if found is not None and time.monotonic() - self._begun[name] >= WARM_UP:
                    self._samples[name].append((time.monotonic(), *found))

    def restart(self, name):
        """Kill a node with SIGKILL and start it again."""
        process = self._running.pop(name)
        process.kill()
        process.wait()
        self._read_log(name)
        self._start(name)

    def hold_up(self, name, seconds):
        """Stop a node for a while."""
        process = self._running[name]
        process.send_signal(signal.SIGSTOP)
        try:
            time.sleep(seconds)
        finally:
            process.send_signal(signal.SIGCONT)

    def send_bad_messages(self, node, count=500):
        """Send fixes and odometry that have to be dropped."""
        fixes = node.create_publisher(PoseWithCovarianceStamped, "global_pose", 10)
        odometry = node.create_publisher(Odometry, "odom", 10)
        fix, step = PoseWithCovarianceStamped(), Odometry()
        fix.pose.pose.position.x = step.twist.twist.linear.x = math.nan
        node.spin_until(lambda: fixes.get_subscription_count() and odometry.get_subscription_count(), 10.0)
        for _ in range(count):
            fixes.publish(fix)
            odometry.publish(step)
            time.sleep(1e-3)
        node.destroy_publisher(fixes)
        node.destroy_publisher(odometry)

    def _read_log(self, name):
        self._tracebacks += (self._folder / f"{name}.log").read_text().count("Traceback")

    def finish(self):
        """Return the growth of each node, and one line for each other defect."""
        failed = self._nodes.failed()
        for name in self._running:
            self._read_log(name)
        defects = [failed] if failed else []
        if self._tracebacks:
            defects.append(f"{self._tracebacks} tracebacks in the logs")
        samples = {name: found for name, found in self._samples.items() if len(found) >= MIN_SAMPLES}
        return {name: growth(found) for name, found in samples.items()}, defects


def growth(samples):
    """Return slope, and threads and descriptors as (median of the first half, median of the second half)."""
    times, memory, threads, descriptors = zip(*samples, strict=True)
    half = len(samples) // 2
    return {
        "minutes": (times[-1] - times[0]) / 60.0,
        "rss": memory[-1],
        "slope": float(theilslopes(memory, [one / 60.0 for one in times]).slope),
        "threads": [median_high(threads[:half]), median_high(threads[half:])],
        "descriptors": [median_high(descriptors[:half]), median_high(descriptors[half:])],
    }
