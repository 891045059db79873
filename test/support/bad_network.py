"""A relay as a process: loses, delays, repeats and reorders: ``python bad_network.py SEED IN:OUT:TYPE ...``."""

import heapq
import importlib
import itertools
import random
import sys
import time

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy

LOSS, REPEATED = 0.2, 0.05
DELAY, JITTER = 0.2, 0.1
"""[s] each message is late by DELAY and up to JITTER more, which changes the order"""
BEST_EFFORT = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)


class BadNetwork(Node):
    """Relays topics; what is due is sent by :meth:`send`."""

    def __init__(self, seed, relays):
        """Create the relays, each (topic in, topic out, type such as ``nav_msgs/Odometry``)."""
        super().__init__("bad_network")
        self._random = random.Random(seed)
        self._waiting, self._count = [], itertools.count()
        for source, target, kind in relays:
            package, name = kind.split("/")
            message_type = getattr(importlib.import_module(f"{package}.msg"), name)
            publisher = self.create_publisher(message_type, target, BEST_EFFORT)
            self.create_subscription(
                message_type, source, lambda data, publisher=publisher: self._take(publisher, data), 100, raw=True
            )

    def _take(self, publisher, data):
        if self._random.random() < LOSS:
            return
        for _ in range(2 if self._random.random() < REPEATED else 1):
            due = time.monotonic() + DELAY + self._random.uniform(0.0, JITTER)
            heapq.heappush(self._waiting, (due, next(self._count), publisher, data))

    def send(self):
        """Send what is due."""
        while self._waiting and self._waiting[0][0] <= time.monotonic():
            _, _, publisher, data = heapq.heappop(self._waiting)
            publisher.publish(data)


def main():
    rclpy.init()
    node = BadNetwork(int(sys.argv[1]), [relay.split(":") for relay in sys.argv[2:]])
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    print("ready", flush=True)
    try:
        while rclpy.ok():
            executor.spin_once(timeout_sec=0.005)
            node.send()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass


if __name__ == "__main__":
    main()
