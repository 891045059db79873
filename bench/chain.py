"""Child process of latency.py: ``python bench/chain.py SCENARIO SIDE NODES SECONDS``.

NODES is a comma-separated list of the nodes of this process: ``source``, ``filter`` and ``control``. They form a chain.

- In the scenario ``clocked``, the source sends odometry at 50 Hz and fixes at 10 Hz, and measures the time until it
  receives each command. In ``lockstep``, the source is a plant that starts a step when it has received the command of
  the previous step.
- The side ``ours`` runs EkfNode, ControllerNode and PlantNode. ``robot`` runs filter and controller as robot_node does.
  ``bare`` runs relays that do not compute anything.

The process of the source prints two JSON lines: one after the warm-up, and one with the results. The other processes
run until SIGINT. If a process has the filter and the controller but not the source, it then prints the times [ms] from
the start of each odometry callback until its command has been published.
"""

# The nodes of this project are imported where they are created, so that processes of relays and drivers start faster.

from __future__ import annotations

import json
import math
import signal
import sys
import time
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np
import rclpy
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from geometry_msgs.msg import Twist as TwistMessage
from nav_msgs.msg import Odometry
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions

from diffbot_control.ros.messages.conversions import goal_message, odometry_message, pose_message
from diffbot_control.ros.messages.fields import (
    fill_planar_covariance,
    fill_pose,
    fill_twist,
    fill_twist_covariance,
    set_stamp,
)
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist, WheelGeometry, encoder_covariance, wheel_speeds
from diffbot_core.ros.run import SPIN_TIMEOUT, make_executor, run

GOAL = Pose(1e5, 0.0, 0.0)
"""So far away that the controller drives during the whole measurement."""
RATE, FIX_EVERY = 50.0, 5
"""Rate of the odometry [Hz], and number of steps per fix."""
DRIVEN = Twist(0.5, 0.1)
"""[m/s], [rad/s] twist in the odometry of the clocked source, which moves on a circle."""
FIX_R = np.diag([0.03, 0.03, 0.0096])
"""Covariance of a fix whose errors are uniform within the paper's bounds of 0.3 m, 0.3 m and 0.17 rad."""
_STEADY = 15
"""The warm-up at 50 Hz ends after this number of consecutive steps that were answered in time."""
_ANSWER_TIMEOUT = 0.5
"""[s] A command that does not arrive within this time counts as lost."""
_WARM_UP = 0.3
"""[s] duration of the lock-step before the measurement"""
_MARGIN = 120
"""[s] A process is killed if it runs longer than the measurement by this time."""


def report(**values: Any) -> None:
    """Print one JSON line for the parent process."""
    print(json.dumps(values), flush=True)


class OdometryRelay(Node):
    """Odometry -> Odometry: publishes the received message."""

    def __init__(self, **options: Any) -> None:
        super().__init__("relay_odometry", **options)
        publisher = self.create_publisher(Odometry, "relayed", 10)
        self.create_subscription(Odometry, "odom", publisher.publish, 10)


class TwistRelay(Node):
    """Odometry -> Twist: publishes the received speed, always in the same message object."""

    def __init__(self, **options: Any) -> None:
        super().__init__("relay_twist", **options)
        self.command = TwistMessage()
        self.publisher = self.create_publisher(TwistMessage, "cmd_vel", 1)
        self.create_subscription(Odometry, "relayed", self.on_odometry, 10)

    def on_odometry(self, message: Odometry) -> None:
        self.command.linear.x = message.twist.twist.linear.x
        self.publisher.publish(self.command)


class ClockedSource(Node):
    """Sends odometry and fixes by a timer, and measures the latency of each command.

    A latency is the time on the monotonic clock from the start of the timer's callback, before its messages are filled,
    to the start of the command's callback. Commands do not have a stamp, but arrive in the order of the odometry. So
    the latencies are valid if one command arrived for each odometry message.
    """

    def __init__(self, seconds: float) -> None:
        super().__init__("source")
        self.done = self.measuring = self.goal_received = False
        self.steps_left = round(seconds * RATE)
        self.latencies: list[float] = []
        self.waiting: deque[int] = deque()
        self.step = self.steady = self.surplus = 0
        wheels = WheelGeometry()
        self.odometry = odometry_message("odom", "base_link")
        fill_twist(self.odometry.twist.twist, DRIVEN)
        fill_twist_covariance(
            self.odometry.twist.covariance, encoder_covariance(wheel_speeds(DRIVEN, wheels), 0.05, wheels)
        )
        self.fix = pose_message("map")
        fill_planar_covariance(self.fix.pose.covariance, FIX_R)
        self.odometries = self.create_publisher(Odometry, "odom", 10)
        self.fixes = self.create_publisher(PoseWithCovarianceStamped, "global_pose", 10)
        self.goals = self.create_publisher(PoseStamped, "goal_pose", 10)
        self.create_subscription(TwistMessage, "cmd_vel", self.on_command, 10)
        self.create_timer(1.0 / RATE, self.on_tick)

    def on_tick(self) -> None:
        now = time.monotonic_ns()
        if self.measuring and self.steps_left == 0:
            # Before the first answer, no command counts as lost, since the start of the chain may be delayed.
            if not self.waiting or (self.latencies and now - self.waiting[-1] > _ANSWER_TIMEOUT * 1e9):
                self.done = True
                report(latencies=self.latencies, lost=len(self.waiting), surplus=self.surplus)
            return
        self.steps_left -= self.measuring
        if not self.measuring:
            self.warm_up()
        self.waiting.append(now)
        self.send(time.time_ns())

    def warm_up(self) -> None:
        """Send goals until commands arrive; begin to measure when _STEADY steps in a row were answered in time."""
        self.steady = 0 if self.waiting or not self.goal_received else self.steady + 1
        self.waiting.clear()
        if not self.goal_received and self.step % FIX_EVERY == 0 and self.goals.get_subscription_count():
            self.goals.publish(goal_message(GOAL, "map", time.time_ns()))
        if self.steady == _STEADY:
            self.measuring, self.surplus = True, 0
            self.steps_left -= 1
            report(event="begin")

    def send(self, stamp: int) -> None:
        """Send the fix, if one is due, and the odometry, as the plant does."""
        theta, radius = DRIVEN.omega * self.step / RATE, DRIVEN.v / DRIVEN.omega
        pose = Pose(radius * math.sin(theta), radius * (1.0 - math.cos(theta)), theta)
        if self.step % FIX_EVERY == 0:
            set_stamp(self.fix.header.stamp, stamp)
            fill_pose(self.fix.pose.pose, pose)
            self.fixes.publish(self.fix)
        set_stamp(self.odometry.header.stamp, stamp)
        fill_pose(self.odometry.pose.pose, pose)
        self.odometries.publish(self.odometry)
        self.step += 1

    def on_command(self, _message: TwistMessage) -> None:
        now = time.monotonic_ns()
        self.goal_received = True
        if not self.waiting:
            self.surplus += 1
            return
        sent = self.waiting.popleft()
        if self.measuring:
            self.latencies.append((now - sent) * 1e-6)


class BarePlant(Node):
    """Lock-step without a plant: sends the next number when the previous one has returned; repeats a lost number."""

    def __init__(self, **options: Any) -> None:
        super().__init__("source", **options)
        self.step, self.sent = 0, 0.0
        self.odometry = odometry_message("odom", "base_link")
        self.odometries = self.create_publisher(Odometry, "odom", 10)
        self.create_subscription(TwistMessage, "cmd_vel", self.on_command, 1)
        self.create_timer(_ANSWER_TIMEOUT, self.on_watch)

    def on_command(self, message: TwistMessage) -> None:
        if message.linear.x == self.step:
            self.step += 1
            self.send()

    def on_watch(self) -> None:
        if time.monotonic() - self.sent > _ANSWER_TIMEOUT:
            self.send()

    def send(self) -> None:
        self.sent = time.monotonic()
        self.odometry.twist.twist.linear.x = float(self.step)
        self.odometries.publish(self.odometry)


def make_node(name: str, scenario: str, side: str, seconds: float) -> Any:
    """Create one of the nodes of a chain with its default options."""
    is_lockstep = scenario == "lockstep"
    if name == "source" and not is_lockstep:
        return ClockedSource(seconds)
    if side == "bare":
        # In lock-step, the reference has neither parameter services nor rosout. At 50 Hz, it has the defaults of rclpy.
        lean = {"start_parameter_services": False, "enable_rosout": False} if is_lockstep else {}
        return {"source": BarePlant, "filter": OdometryRelay, "control": TwistRelay}[name](**lean)
    from diffbot_control.controller_node import ControllerNode
    from diffbot_control.ekf_node import EkfNode
    from diffbot_sim.plant_node import PlantNode

    stamped = [Parameter("cmd_vel_type", value="twist_stamped" if is_lockstep else "twist")]
    if name == "source":
        return PlantNode(parameter_overrides=[Parameter("clock", value="lockstep"), *stamped])
    overrides = [Parameter("reliable_inputs", value=is_lockstep)]
    if name == "filter":
        return EkfNode(parameter_overrides=overrides)
    # In lock-step, the controller must answer each pose, even without a goal.
    idle = [Parameter("publish_when_idle", value=True), *stamped] if is_lockstep else []
    return ControllerNode(parameter_overrides=[*idle, *overrides])


def spin_once(executor: Any) -> None:
    """Spin without a timeout, as ``spin`` does, except with an EventsExecutor (see make_executor)."""
    executor.spin_once(timeout_sec=None if type(executor) is SingleThreadedExecutor else SPIN_TIMEOUT)


def measure(scenario: str, side: str, nodes: list[Any], seconds: float) -> None:
    """Spin until the source, which is the first node, has finished its measurement."""
    # A clocked source in a process of its own is not part of the comparison: it has the same executor on both sides.
    is_driver = scenario == "clocked" and len(nodes) == 1
    executor = SingleThreadedExecutor() if side == "bare" and not is_driver else make_executor()
    for node in nodes:
        executor.add_node(node)
    source = nodes[0]
    if scenario == "clocked":
        while not source.done:
            spin_once(executor)
        return
    if side != "bare":
        # The plant starts when all nodes are present.
        goals = source.create_publisher(PoseStamped, "goal_pose", 10)
        while not goals.get_subscription_count():
            executor.spin_once(timeout_sec=SPIN_TIMEOUT)
        goals.publish(goal_message(GOAL, "map", source.stamp))
    measure_rate(lambda: source.step, executor, seconds)


def measure_rate(step: Callable[[], int], executor: Any, seconds: float) -> None:
    """Report the steps per second of a lock-step plant after the warm-up."""
    first = 0.0
    while not first or time.monotonic() - first < _WARM_UP:
        spin_once(executor)
        first = first or (step() > 1) * time.monotonic()
    report(event="begin")
    began, first_step = time.monotonic(), step()
    # Wait for at least one step, so that a delayed chain does not report a rate of 0.
    while time.monotonic() - began < seconds or step() == first_step:
        spin_once(executor)
    report(rate=(step() - first_step) / (time.monotonic() - began))


def run_bare(nodes: list[Any]) -> None:
    """Run the relays until SIGINT by ``spin`` of the default executor, as most users do."""
    try:
        executor = SingleThreadedExecutor()
        for node in nodes:
            executor.add_node(node)
        executor.spin()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass


def record_durations() -> list[float]:
    """Return a list that collects the time [ms] from each odometry callback until its command has been published."""
    from diffbot_control.ekf_node import EkfNode
    from diffbot_control.ros.controller_publishers import CommandOutput

    durations: list[float] = []
    began = 0
    receive, send = EkfNode._on_odometry, CommandOutput.send

    def timed_receive(node: EkfNode, message: Odometry) -> None:
        nonlocal began
        began = time.perf_counter_ns()
        receive(node, message)

    def timed_send(publishers: CommandOutput, *arguments: Any) -> None:
        send(publishers, *arguments)
        durations.append((time.perf_counter_ns() - began) * 1e-6)

    EkfNode._on_odometry, CommandOutput.send = timed_receive, timed_send
    return durations


def main() -> int:
    """Run the nodes named on the command line."""
    scenario, side, names, seconds = sys.argv[1], sys.argv[2], sys.argv[3].split(","), float(sys.argv[4])
    # SIGALRM ends this process even if an error occurs here or in the parent process.
    signal.alarm(math.ceil(seconds) + _MARGIN)
    if "source" not in names and side != "bare":
        durations = record_durations() if len(names) > 1 else []
        if side == "robot":
            from diffbot_control.robot_node import make_nodes

            status = run(make_nodes)
        else:
            status = run(lambda: (make_node(name, scenario, side, seconds) for name in names))
        report(inside=durations)
        return status
    if "source" not in names:
        rclpy.init()
        run_bare([make_node(name, scenario, side, seconds) for name in names])
        return 0
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    nodes = [make_node(name, scenario, side, seconds) for name in names]
    measure(scenario, side, nodes, seconds)
    for node in nodes:
        node.destroy_node()
    rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
