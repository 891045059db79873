"""Whether the controller that a client waits for still lives.

Its latched status stays with its subscribers when it dies, whatever it says. But the publisher of the status has a
lease: DDS reports when the process no longer renews it, however busy the process may be. A process that hangs
shows by its silence, as does a dead one where DDS reports nothing: the status comes twice a second.
"""

from __future__ import annotations

import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.event_handler import SubscriptionEventCallbacks, UnsupportedEventTypeError
from rclpy.node import Node

from diffbot_core.ros.qos import STATUS

SILENCE = 10.0
"""[s] without any message after which a controller is taken for dead though DDS has not reported it"""
_PAUSE = 0.5
"""[s] a client that looks less often has not received what came meanwhile"""


class ControllerWatch:
    """Watches the status of one controller; the node's owner spins it."""

    def __init__(self, node: Node, controller: str, timeout: float) -> None:
        """Subscribe to ``controller``/status; a controller that is away for ``timeout`` [s] is gone."""
        self._timeout = timeout
        self._lost: float | None = None
        self._last_sign = self._last_look = time.monotonic()
        topic = f"{controller}/status"
        events = SubscriptionEventCallbacks(liveliness=self._on_liveliness)
        try:
            node.create_subscription(DiagnosticStatus, topic, self._on_status, STATUS, event_callbacks=events)
        except UnsupportedEventTypeError:
            node.create_subscription(DiagnosticStatus, topic, self._on_status, STATUS)

    def note_sign(self) -> None:
        """Note that something of the controller was received."""
        self._last_sign = time.monotonic()

    def is_gone(self) -> bool:
        """Return True if the controller has died or left, and has not come back in time."""
        now = time.monotonic()
        before, self._last_look = self._last_look, now
        if now - before > _PAUSE:
            self._last_sign = now
        is_lost = self._lost is not None and now - self._lost >= self._timeout
        return is_lost or now - self._last_sign >= self._timeout + SILENCE

    def _on_status(self, _message: DiagnosticStatus) -> None:
        self.note_sign()

    def _on_liveliness(self, info: Any) -> None:
        if info.alive_count > 0:
            self._lost = None
        elif self._lost is None:
            self._lost = time.monotonic()
