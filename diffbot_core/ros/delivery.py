"""Before a publisher is destroyed, its readers get time to receive what was published: afterwards they never will."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from typing import Any

from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import ReliabilityPolicy

TIMEOUT = 1.0
"""[s] for reliable readers to acknowledge the message; one that is held up for longer must not keep the node alive"""
PATIENCE = 1.5
"""[s] for reliable readers to receive what a node published before its end"""
REPEATS = 6
"""times the message is published where delivery is best effort, which nobody acknowledges"""
_RESEND_PERIOD = 0.1
"""[s] a lost message is published again after this time; the middleware itself would ask for it every 3 s only"""
_REPEAT_PERIOD = 0.05


def deliver(node: Node, publisher: Any, publish: Callable[[], None]) -> bool:
    """Call ``publish`` until each matched reader has a message of it; return whether all reliable ones have.

    Nothing has to be spun meanwhile. It takes TIMEOUT at most.

    Args:
        node: of the publisher.
        publisher: what ``publish`` publishes with.
        publish: publishes the message.
    """
    deadline = time.monotonic() + TIMEOUT
    due = REPEATS if _is_best_effort(node, publisher.topic_name) else 1
    while True:
        publish()
        due -= 1
        acknowledged = bool(publisher.wait_for_all_acked(Duration(seconds=_RESEND_PERIOD)))
        if (acknowledged and due <= 0) or time.monotonic() >= deadline:
            return acknowledged
        if acknowledged:
            time.sleep(_REPEAT_PERIOD)


def await_readers(nodes: Iterable[Node]) -> None:
    """Wait until all reliable readers have what the nodes published, PATIENCE [s] at most in total."""
    deadline = time.monotonic() + PATIENCE
    for node in nodes:
        for publisher in node.publishers:
            publisher.wait_for_all_acked(Duration(seconds=max(0.0, deadline - time.monotonic())))


def _is_best_effort(node: Node, topic: str) -> bool:
    """Return whether any reader or publisher of a topic is best effort."""
    ends = [*node.get_subscriptions_info_by_topic(topic), *node.get_publishers_info_by_topic(topic)]
    return any(end.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT for end in ends)
