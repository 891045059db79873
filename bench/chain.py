"""Child process of latency.py: ``python bench/chain.py SCENARIO SIDE NODES SECONDS``.

NODES is a comma-separated part of ``source,filter,control``. In the scenario ``clocked`` the source sends odometry at
50 Hz and fixes at 10 Hz, and measures the time until it receives the command. In ``lockstep`` the source is a plant
that makes its next step when it receives the command for the present step. The side ``ours`` runs EkfNode,
ControllerNode and PlantNode. ``robot`` runs the filter and the controller of robot_node. ``bare`` runs relays that
compute nothing.

The process of the source prints two JSON lines, one when the chain has warmed up and one with the measurement. The
other processes run until SIGINT. If filter and controller share a process without the source, this process then prints
the times [ms] from each callback for odometry until its command is published.
"""

# The nodes of this project are imported where they are created, so that relays and drivers start quickly.

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
"""Goal that the robot does not reach during the measurement."""
RATE, FIX_EVERY = 50.0, 5
"""[Hz] of the odometry, and steps per fix."""
DRIVEN = Twist(0.5, 0.1)
"""[m/s], [rad/s] twist of the clocked source, which drives a circle."""
FIX_R = np.diag([0.03, 0.03, 0.0096])
"""Covariance of a fix, uniform within the paper's bounds of 0.3 m, 0.3 m and 0.17 rad."""
_STEADY = 15
"""Steps in a row that are answered in time, after which the warm-up at 50 Hz ends."""
_ANSWER_TIMEOUT = 0.5
"""[s] after which an answer counts as lost."""
_WARM_UP = 0.3
"""[s] length of the warm-up in lock-step."""
_MAX_LIFE = 120
"""[s] after which a process ends itself, in addition to the time of the measurement."""


def report(**values: Any) -> None:
    """Print a line for latency.py."""
    print(json.dumps(values), flush=True)


class OdometryRelay(Node):
    """Odometry -> Odometry: publishes each received message."""

    def __init__(self, **options: Any) -> None:
        super().__init__("relay_odometry", **options)
        publisher = self.create_publisher(Odometry, "relayed", 10)
        self.create_subscription(Odometry, "odom", publisher.publish, 10)


class TwistRelay(Node):
    """Odometry -> Twist: publishes the same message object each time."""

    def __init__(self, **options: Any) -> None:
        super().__init__("relay_twist", **options)
        self.command = TwistMessage()
        self.publisher = self.create_publisher(TwistMessage, "cmd_vel", 1)
        self.create_subscription(Odometry, "relayed", self.on_odometry, 10)

    def on_odometry(self, message: Odometry) -> None:
        self.command.linear.x = message.twist.twist.linear.x
        self.publisher.publish(self.command)


class ClockedSource(Node):
    """Sends odometry and fixes by a timer, and measures the time until the command arrives.

    A latency is the time from the timer's callback, before it fills its messages, to the callback for the command.
    Commands have no stamp, but they arrive in the order of the odometry. If no message is lost, the n-th command
    answers the n-th odometry.
    """

    def __init__(self, seconds: float) -> None:
        super().__init__("source")
        self.done = self.measuring = self.goal_received = False
        self.steps_left = round(seconds * RATE)
        self.latencies: list[float] = []
        self.waiting: deque[int] = deque()
        self.step = self.steady = self.unasked = 0
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
            # Before the first answer nothing counts as lost, since the chain may start slowly.
            if not self.waiting or (self.latencies and now - self.waiting[-1] > _ANSWER_TIMEOUT * 1e9):
                self.done = True
                report(latencies=self.latencies, lost=len(self.waiting), unasked=self.unasked)
            return
        self.steps_left -= self.measuring
        if not self.measuring:
            self.warm_up()
        self.waiting.append(now)
        self.send(time.time_ns())

    def warm_up(self) -> None:
        """Send goals until commands arrive. Start to measure after _STEADY steps that were answered in time."""
        self.steady = 0 if self.waiting or not self.goal_received else self.steady + 1
        self.waiting.clear()
        if not self.goal_received and self.step % FIX_EVERY == 0 and self.goals.get_subscription_count():
            self.goals.publish(goal_message(GOAL, "map", time.time_ns()))
        if self.steady == _STEADY:
            self.measuring, self.unasked = True, 0
            self.steps_left -= 1
            report(event="begin")

    def send(self, stamp: int) -> None:
        """Send the fix, if it is due, and the odometry."""
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
            self.unasked += 1
            return
        sent = self.waiting.popleft()
        if self.measuring:
            self.latencies.append((now - sent) * 1e-6)


class BarePlant(Node):
    """Lock-step without a plant: sends the next number when the present one returns, and sends a lost number again."""

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
    """Create a node of a chain."""
    is_lockstep = scenario == "lockstep"
    if name == "source" and not is_lockstep:
        return ClockedSource(seconds)
    if side == "bare":
        # In lock-step the reference has neither parameter services nor rosout. At 50 Hz it has rclpy's defaults.
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
    # In lock-step the controller has to answer each pose, also without a goal.
    idle = [Parameter("publish_when_idle", value=True), *stamped] if is_lockstep else []
    return ControllerNode(parameter_overrides=[*idle, *overrides])


def spin_once(executor: Any) -> None:
    """Spin once, with a timeout only where the executor needs it, see make_executor."""
    executor.spin_once(timeout_sec=None if type(executor) is SingleThreadedExecutor else SPIN_TIMEOUT)


def measure(scenario: str, side: str, nodes: list[Any], seconds: float) -> None:
    """Spin until the source, which is the first node, has measured."""
    # A clocked source alone in its process has the same executor on both sides.
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
        # The plant starts when the graph is complete.
        goals = source.create_publisher(PoseStamped, "goal_pose", 10)
        while not goals.get_subscription_count():
            executor.spin_once(timeout_sec=SPIN_TIMEOUT)
        goals.publish(goal_message(GOAL, "map", source.stamp))
    measure_rate(lambda: source.step, executor, seconds)


def measure_rate(step: Callable[[], int], executor: Any, seconds: float) -> None:
    """Report the steps per second of a lock-step plant after its warm-up."""
    first = 0.0
    while not first or time.monotonic() - first < _WARM_UP:
        spin_once(executor)
        first = first or (step() > 1) * time.monotonic()
    report(event="begin")
    began, first_step = time.monotonic(), step()
    # At least one step, since a chain that is held up would have no rate.
    while time.monotonic() - began < seconds or step() == first_step:
        spin_once(executor)
    report(rate=(step() - first_step) / (time.monotonic() - began))


def run_bare(nodes: list[Any]) -> None:
    """Run the relays until SIGINT by ``spin`` of the default executor."""
    try:
        executor = SingleThreadedExecutor()
        for node in nodes:
            executor.add_node(node)
        executor.spin()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass


def watch() -> list[float]:
    """Return a list that will contain the times [ms] from each callback for odometry until its command is published."""
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
    # The process ends even if its parent was killed.
    signal.alarm(math.ceil(seconds) + _MAX_LIFE)
    if "source" not in names and side != "bare":
        durations = watch() if len(names) > 1 else []
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
