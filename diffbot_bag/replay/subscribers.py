"""Wait for the subscribers of a replay: until they are matched, and until they have acknowledged. Free of ROS."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Collection, Mapping
from typing import Any, Protocol

POLL = 0.02
"""[s] between two checks of the subscribers"""
SETTLE = 0.25
"""[s] allowance for discovery and last messages to reach the subscribers, which publishers cannot observe"""


class Output(Protocol):
    """The part of rclpy's Publisher that is used here."""

    def get_subscription_count(self) -> int:
        """Return the number of matched subscribers."""

    def wait_for_all_acked(self, timeout: Any) -> bool:
        """Return True once all reliable subscribers have acknowledged all messages, False after ``timeout``."""


def wait_for_subscribers(
    outputs: Mapping[str, Output], topics: Collection[str], timeout: float, stop: threading.Event
) -> set[str]:
    """Wait until each of these topics has a subscriber; messages sent earlier would be lost to it.

    A publisher is matched a moment before its subscriber is, hence the additional wait of SETTLE.

    Args:
        outputs: publishers by topic.
        topics: topics to wait for; each has a publisher.
        timeout: [s] maximum wait.
        stop: ends the wait when set.

    Returns:
        Topics without a subscriber.
    """
    missing = set(topics)
    deadline = time.monotonic() + timeout
    while not stop.is_set():
        missing = {topic for topic in missing if outputs[topic].get_subscription_count() == 0}
        if not missing or time.monotonic() >= deadline:
            break
        stop.wait(POLL)
    if len(missing) < len(set(topics)):
        stop.wait(SETTLE)
    return missing


def wait_until_acknowledged(
    outputs: Mapping[str, Output], timeout: float, poll: Any, stop: threading.Event
) -> set[str]:
    """Wait until the reliable subscribers have acknowledged all messages.

    Args:
        outputs: publishers by topic.
        timeout: [s] maximum wait; 0: no limit, negative: no wait.
        poll: interval at which ``stop`` is checked, as a Duration of rclpy.
        stop: ends the wait when set.

    Returns:
        Topics with messages that are not acknowledged.
    """
    missing = set(outputs) if timeout >= 0.0 else set()
    deadline = time.monotonic() + (timeout or math.inf)
    while missing and not stop.is_set():
        missing = {topic for topic in missing if not outputs[topic].wait_for_all_acked(poll)}
        if time.monotonic() >= deadline:
            break
    return missing
