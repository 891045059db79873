"""When a client takes its controller for dead: by the lease of the status, or by long silence."""

import pytest
from rclpy.event_handler import UnsupportedEventTypeError

from diffbot_control.ros import controller_watch
from diffbot_control.ros.controller_watch import SILENCE, ControllerWatch


class FakeNode:
    """Notes the subscription's callbacks."""

    def __init__(self, has_events=True):
        self.has_events = has_events

    def create_subscription(self, _type, _topic, callback, _qos, event_callbacks=None):
        if event_callbacks is not None and not self.has_events:
            raise UnsupportedEventTypeError
        self.on_status = callback


@pytest.mark.parametrize("has_events", [True, False])
def test_silence_where_no_lease_is_reported(has_events, monkeypatch):
    now, node = [100.0], FakeNode(has_events)
    monkeypatch.setattr(controller_watch.time, "monotonic", lambda: now[0])
    watch = ControllerWatch(node, "controller", 1.0)

    def is_gone_within(seconds):
        """A client looks every 0.1 s."""
        for _ in range(round(10 * seconds)):
            now[0] += 0.1
            if watch.is_gone():
                return True
        return False

    # A client that did not look has not received silence.
    now[0] += 100.0
    assert not watch.is_gone()
    for sign in (lambda: node.on_status(None), watch.note_sign):
        assert not is_gone_within(SILENCE + 0.9)
        sign()
    assert not is_gone_within(SILENCE + 0.9)
    assert is_gone_within(0.2)
