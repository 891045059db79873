"""A relay that loses messages by a seed: what a radio link or a full buffer does to best-effort sensors."""

import random

from rclpy.qos import QoSProfile, ReliabilityPolicy

BEST_EFFORT = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
"""As sensor drivers publish."""


class LossyRelay:
    """Passes messages of one topic on, best effort, except for a share of them."""

    def __init__(self, node, message_type, source, target, loss, seed):
        """Relay ``source`` to ``target`` on ``node``; each message is lost with probability ``loss``."""
        self._draw = random.Random(seed)
        self._loss = loss
        self.passed = self.lost = 0
        self._publisher = node.create_publisher(message_type, target, BEST_EFFORT)
        node.create_subscription(message_type, source, self._relay, 100)

    def _relay(self, message):
        if self._draw.random() < self._loss:
            self.lost += 1
        else:
            self.passed += 1
            self._publisher.publish(message)
