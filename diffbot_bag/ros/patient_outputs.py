"""Publishers that wait for slow subscribers instead of overwriting what these have not acknowledged."""

from __future__ import annotations

import threading
import time
from typing import Any

from rclpy.duration import Duration
from rclpy.impl.implementation_singleton import rclpy_implementation

from diffbot_bag.replay.subscribers import POLL

RCLError = rclpy_implementation.RCLError
REFUSAL = 0.02
"""[s] A full publisher raises RCLError after DDS's blocking time of 0.1 s; what fails sooner has another reason."""


class KeepingOutput:
    """Publishes on a history that keeps all: DDS itself waits until its oldest message is acknowledged.

    A history that keeps only the last messages is overwritten, or has to be acknowledged as a whole, for which DDS asks
    at its heartbeat: each 3 s by default.
    """

    def __init__(self, publisher: Any, patience: float, stop: threading.Event) -> None:
        """Start with a publisher, the longest wait [s] for room, and what ends every wait."""
        self._publisher, self._patience, self._stop = publisher, patience, stop

    def send(self, data: bytes) -> bool:
        """Publish when there is room; return False if there was none in time.

        Raises:
            RCLError: if it cannot be published for another reason.
        """
        deadline = time.monotonic() + self._patience
        while not self._stop.is_set():
            began = time.monotonic()
            try:
                self._publisher.publish(data)
                break
            except RCLError:
                now = time.monotonic()
                if now - began < REFUSAL:
                    raise
                if now >= deadline:
                    return False
        return True


class BoundedOutput:
    """Publishes as long as fewer messages than a bound are not acknowledged; its history has room for them."""

    def __init__(self, publisher: Any, bound: int, stop: threading.Event) -> None:
        """Start with a publisher, the bound, and what ends every wait."""
        self._publisher, self._bound, self._stop = publisher, bound, stop
        self._unacknowledged = 0

    def send(self, data: bytes) -> bool:
        """Publish; at the bound, first wait until all messages sent before are acknowledged. Always returns True."""
        if self._unacknowledged >= self._bound:
            # A full history makes DDS ask for acknowledgement at once, and not only at its next heartbeat.
            while not self._publisher.wait_for_all_acked(Duration(seconds=POLL)) and not self._stop.is_set():
                pass
            self._unacknowledged = 0
        if not self._stop.is_set():
            self._unacknowledged += 1
            self._publisher.publish(data)
        return True
