"""Restart of the filter: seconds from starting ekf_node, with a state_file, to its first pose at a subscriber.

Odometry comes at 100 Hz all the time, as from a robot whose filter alone has died. Run as a program, it measures some
starts and prints them.
"""

from __future__ import annotations

import argparse
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import rclpy
from bench_table import BenchError
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node

from diffbot_control.filter.state_file import SavedState, save_state
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import WheelGeometry

RATE = 100.0
"""[Hz] of the odometry"""
_TIMEOUT = 30.0
"""[s] within which the first pose must come, and within which the node must have ended"""
_QUIET = 0.3
"""[s] without a pose after which those of the process before have come"""


class Driver(Node):  # type: ignore[misc]
    """Publishes odometry of a robot at rest, and counts poses."""

    def __init__(self) -> None:
        """Start publishing."""
        super().__init__("driver")
        self.poses = 0
        self._message = Odometry(child_frame_id="base_link")
        self._message.header.frame_id = "odom"
        self._message.pose.pose.orientation.w = 1.0
        self._message.twist.covariance[[0, 35]] = 1e-4
        self._odometry = self.create_publisher(Odometry, "odom", 10)
        self.create_subscription(PoseWithCovarianceStamped, "pose", self._on_pose, 10)
        self.create_timer(1.0 / RATE, self._publish)

    def _publish(self) -> None:
        self._message.header.stamp = self.get_clock().now().to_msg()
        self._odometry.publish(self._message)

    def _on_pose(self, _message: PoseWithCovarianceStamped) -> None:
        self.poses += 1


def first_pose(driver: Driver, folder: Path) -> float:
    """Start the filter, wait for its first pose, end it; return the seconds between.

    Raises:
        BenchError: if no pose comes in time.
    """
    state = folder / "state.json"
    save_state(state, SavedState(Pose(1.0, 2.0, 0.5), np.diag([1e-4, 1e-4, 1e-4]), None, WheelGeometry()))
    command = [str(Path(sys.executable).with_name("ekf_node")), "--ros-args", "-p", f"state_file:={state}"]
    _drain(driver)
    driver.poses = 0
    began = time.perf_counter()
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        try:
            while not driver.poses:
                rclpy.spin_once(driver, timeout_sec=0.05)
                if process.poll() is not None or time.perf_counter() - began > _TIMEOUT:
                    raise BenchError("ekf: no pose after its start")
            seconds = time.perf_counter() - began
            process.terminate()
            process.wait(_TIMEOUT)
        finally:
            if process.poll() is None:
                process.kill()
    return seconds


def _drain(driver: Driver) -> None:
    """Receive what the process before has sent."""
    quiet = time.perf_counter() + _QUIET
    while time.perf_counter() < quiet:
        before = driver.poses
        rclpy.spin_once(driver, timeout_sec=0.01)
        if driver.poses > before:
            quiet = time.perf_counter() + _QUIET


def measure(starts: int) -> list[float]:
    """Return the seconds of each start.

    Raises:
        BenchError: if no pose comes in time.
    """
    rclpy.init()
    driver = Driver()
    try:
        with tempfile.TemporaryDirectory() as folder:
            return [first_pose(driver, Path(folder)) for _ in range(starts)]
    finally:
        driver.destroy_node()
        rclpy.try_shutdown()


def main() -> int:
    """Measure and print; return the exit status."""
    parser = argparse.ArgumentParser(description="Seconds from the start of the filter to its first pose.")
    parser.add_argument("--starts", type=int, default=10)
    try:
        seconds = measure(parser.parse_args().starts)
    except BenchError as error:
        print(error, file=sys.stderr)
        return 1
    print(" ".join(f"{one:.3f}" for one in seconds))
    cpu = resource.getrusage(resource.RUSAGE_CHILDREN)
    print(f"CPU time {(cpu.ru_utime + cpu.ru_stime) / len(seconds):.2f} s each, its end included", file=sys.stderr)
    print(f"median {statistics.median(seconds):.2f} s, {min(seconds):.2f} .. {max(seconds):.2f} s", file=sys.stderr)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
