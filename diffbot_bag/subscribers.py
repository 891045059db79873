"""Waiting for the subscribers of a replay: until they are there, and until they have everything; free of ROS."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Collection, Mapping
from typing import Any, Protocol

POLL = 0.02
"""[s] between two looks at the subscribers."""
SETTLE = 0.25
"""[s] in which discovery and the last messages reach the other side, of which a publisher hears nothing."""


class Output(Protocol):
    """What is asked of a publisher of rclpy."""

    def get_subscription_count(self) -> int:
        """Return the number of subscribers that know the publisher."""

    def wait_for_all_acked(self, timeout: Any) -> bool:
        """Return True once all reliable subscribers have all messages, False after ``timeout``."""


def wait_for_subscribers(
    outputs: Mapping[str, Output], topics: Collection[str], timeout: float, stop: threading.Event
) -> set[str]:
    """Wait until each of these topics has a subscriber, since what is sent before is lost to it.

    A publisher knows its subscriber a moment before it is known itself: that moment is waited for, too.

    Args:
        outputs: publishers by topic.
        topics: the topics waited for; all have a publisher.
        timeout: [s] longest wait.
        stop: ends the wait when set.

    Returns:
        Topics that still have none.
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
        timeout: [s] longest wait; 0 for no limit, negative for none at all.
        poll: a short time in the form that publishers take, after which ``stop`` is looked at.
        stop: ends the wait when set.

    Returns:
        Topics of which something is not acknowledged.
    """
    missing = set(outputs) if timeout >= 0.0 else set()
    deadline = time.monotonic() + (timeout or math.inf)
    while missing and not stop.is_set():
        missing = {topic for topic in missing if not outputs[topic].wait_for_all_acked(poll)}
        if time.monotonic() >= deadline:
            break
    return missing
