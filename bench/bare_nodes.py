"""The bare nodes of the benchmark: relays that do no work, and the sources that drive a chain and measure it."""

from __future__ import annotations

import json
import math
import time
from collections import deque
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from geometry_msgs.msg import Twist as TwistMessage
from nav_msgs.msg import Odometry
from rclpy.node import Node

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

GOAL = Pose(1e5, 0.0, 0.0)
"""Far enough that the controller drives all the time."""
RATE, FIX_EVERY = 50.0, 5
"""[Hz] of the odometry; every fifth step brings a fix: 10 Hz."""
DRIVEN = Twist(0.5, 0.1)
"""[m/s], [rad/s] what the clocked source claims to drive: a circle."""
FIX_R = np.diag([0.03, 0.03, 0.0096])
"""Covariance of a fix, uniform within the paper's bounds: 0.3 m, 0.3 m, 0.17 rad."""
_STEADY = 15
"""Steps answered in time, one after the other, that end the warm-up at 50 Hz."""
_PATIENCE = 0.5
"""[s] without an answer after which it is taken as lost."""


def report(event: str, **values: Any) -> None:
    """Print one line for the parent."""
    print(json.dumps({"event": event, **values}), flush=True)


class OdometryRelay(Node):
    """Odometry -> Odometry: sends on the very message that came."""

    def __init__(self, **options: Any) -> None:
        super().__init__("relay_odometry", **options)
        publisher = self.create_publisher(Odometry, "relayed", 10)
        self.create_subscription(Odometry, "odom", publisher.publish, 10)


class TwistRelay(Node):
    """Odometry -> Twist: one message object, used again and again."""

    def __init__(self, **options: Any) -> None:
        super().__init__("relay_twist", **options)
        self.command = TwistMessage()
        self.publisher = self.create_publisher(TwistMessage, "cmd_vel", 1)
        self.create_subscription(Odometry, "relayed", self.on_odometry, 10)

    def on_odometry(self, message: Odometry) -> None:
        self.command.linear.x = message.twist.twist.linear.x
        self.publisher.publish(self.command)


class ClockedSource(Node):
    """Sends odometry (50 Hz) and fixes (10 Hz) by a timer; measures the time until the command is back here.

    A latency runs from the timer's callback, before its messages are filled, to the callback of the command, on the
    monotonic clock. Commands carry no stamp: they come in the order of the odometry, and if as many came as were
    sent, each latency is that of its own step. A period is the time between two commands.
    """

    def __init__(self, seconds: float) -> None:
        super().__init__("source")
        self.done = False
        self.steps_left = round(seconds * RATE)
        self.latencies: list[float] = []
        self.periods: list[float] = []
        self.last_command = 0
        self.waiting: deque[int] = deque()
        self.unasked = 0
        self.step = self.steady = 0
        self.measuring = self.goal_received = False
        self.make_messages()
        self.odometries = self.create_publisher(Odometry, "odom", 10)
        self.fixes = self.create_publisher(PoseWithCovarianceStamped, "global_pose", 10)
        self.goals = self.create_publisher(PoseStamped, "goal_pose", 10)
        self.create_subscription(TwistMessage, "cmd_vel", self.on_command, 10)
        self.create_timer(1.0 / RATE, self.on_tick)

    def make_messages(self) -> None:
        """Fill in what stays the same in each step."""
        wheels = WheelGeometry()
        variances = encoder_covariance(wheel_speeds(DRIVEN, wheels), 0.05, wheels)
        self.odometry = odometry_message("odom", "base_link")
        fill_twist(self.odometry.twist.twist, DRIVEN)
        fill_twist_covariance(self.odometry.twist.covariance, variances)
        self.fix = pose_message("map")
        fill_planar_covariance(self.fix.pose.covariance, FIX_R)

    def on_tick(self) -> None:
        now = time.monotonic_ns()
        if self.measuring and self.steps_left == 0:
            # Before the first answer nothing is taken as lost: the chain may be held up.
            if not self.waiting or (self.latencies and now - self.waiting[-1] > _PATIENCE * 1e9):
                self.end()
            return
        self.steps_left -= self.measuring
        if not self.measuring:
            self.warm_up()
        self.waiting.append(now)
        self.send(time.time_ns())

    def warm_up(self) -> None:
        """Send goals until commands come; begin when the chain has answered for a while without delay."""
        self.steady = 0 if self.waiting or not self.goal_received else self.steady + 1
        self.waiting.clear()
        if not self.goal_received and self.step % FIX_EVERY == 0 and self.goals.get_subscription_count():
            self.goals.publish(goal_message(GOAL, "map", time.time_ns()))
        if self.steady == _STEADY:
            self.measuring, self.unasked = True, 0
            self.steps_left -= 1
            report("begin")

    def send(self, stamp: int) -> None:
        """Send the fix, if one is due, and the odometry, as the plant does."""
        theta = DRIVEN.omega * self.step / RATE
        radius = DRIVEN.v / DRIVEN.omega
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
            self.periods.append((now - self.last_command) * 1e-6)
        self.last_command = now

    def end(self) -> None:
        self.done = True
        report("end", latencies=self.latencies, periods=self.periods, lost=len(self.waiting), unasked=self.unasked)


class BarePlant(Node):
    """Lock-step without a plant: the next number when this one has come back. A lost one is sent again."""

    def __init__(self, **options: Any) -> None:
        super().__init__("source", **options)
        self.step = 0
        self.sent = 0.0
        self.odometry = odometry_message("odom", "base_link")
        self.odometries = self.create_publisher(Odometry, "odom", 10)
        self.create_subscription(TwistMessage, "cmd_vel", self.on_command, 1)
        self.create_timer(_PATIENCE, self.on_watch)

    def on_command(self, message: TwistMessage) -> None:
        if message.linear.x == self.step:
            self.step += 1
            self.send()

    def on_watch(self) -> None:
        if time.monotonic() - self.sent > _PATIENCE:
            self.send()

    def send(self) -> None:
        self.sent = time.monotonic()
        self.odometry.twist.twist.linear.x = float(self.step)
        self.odometries.publish(self.odometry)
