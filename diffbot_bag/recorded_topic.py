"""One topic that is being recorded: its subscription, its losses, and the publishers that do not match."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

from diffbot_bag.conversions import from_ros, message_class, offers, to_ros
from diffbot_bag.losses import LossCounter
from diffbot_bag.qos import Qos, to_request
from diffbot_core.ros.watches import full_name

Receive = Callable[[bytes, dict[str, Any]], None]


class RecordedTopic:
    """A topic: its channel in the bag, its subscription, and the publishers that do not match the subscription."""

    def __init__(self, name: str, type_name: str, channel: int, request: Qos, fixed: bool) -> None:
        """Start without a subscription; ``request`` is its QoS, ``fixed`` if a file of overrides gives it."""
        self.name, self.type_name, self.channel, self.request, self.fixed = name, type_name, channel, request, fixed
        self.losses = LossCounter(self.publisher_count)
        self.received = 0
        """messages accepted"""
        self.polls = 0
        """times that the topic was looked at since it was subscribed to"""
        self.unmatched: dict[str, str] = {}
        """why a publisher is not recorded, by the name of its node"""
        self._subscription: Any = None
        self._subscribed = 0
        """times that the topic was subscribed to"""
        self._receive: Receive = lambda _data, _info: None

    def publisher_count(self) -> int:
        """Return the number of matched publishers."""
        return int(self._subscription.get_publisher_count())

    def subscribe(self, node: Any, receive: Receive) -> None:
        """Subscribe to the raw messages; ``receive`` is called with the bytes and the info of each."""
        self._receive = receive
        self._subscribed = number = self._subscribed + 1

        def adapted(data: Any, info: Any = None) -> None:
            if info is None:
                # The EventsExecutor of rclpy 7.1.6 passes one pair, other executors two arguments.
                data, info = data
            # An executor may serve an earlier subscription for a moment after it was destroyed.
            if number == self._subscribed:
                receive(data, info)

        # rclpy inspects the signature to find out whether to pass the info.
        adapted.__signature__ = inspect.signature(receive)  # type: ignore[attr-defined]
        kind, qos = message_class(self.type_name), to_ros(self.request)
        self._subscription = node.create_subscription(kind, self.name, adapted, qos, raw=True)

    def take_pending(self) -> int | None:
        """Receive one message that no executor has taken; return its source timestamp [ns], None without a message."""
        with self._subscription.handle:
            taken = self._subscription.handle.take_message(self._subscription.msg_type, True)
        if taken is None:
            return None
        self._receive(*taken)
        return int(taken[1]["source_timestamp"])

    def find_unmatched(self, node: Any) -> dict[str, str]:
        """Look at the publishers of the graph; return those newly found unmatched, with the reason."""
        self.polls += 1
        before, self.unmatched = self.unmatched, {}
        if node.count_publishers(self.name) > self.publisher_count():
            publishers = node.get_publishers_info_by_topic(self.name)
            reasons = ((full_name(one), self._mismatch(one)) for one in publishers)
            self.unmatched = {name: reason for name, reason in reasons if reason}
        return {name: reason for name, reason in self.unmatched.items() if before.get(name) != reason}

    def _mismatch(self, publisher: Any) -> str:
        """Return why the subscription does not match a publisher; empty if it does, even if a moment later."""
        if publisher.topic_type != self.type_name:
            return f"its type is {publisher.topic_type}"
        offered = from_ros(publisher.qos_profile)
        if self.request.reliability == "reliable" and offered.reliability == "best_effort":
            return "it offers best effort only"
        if self.request.durability == "transient_local" and offered.durability == "volatile":
            return "it is not transient local"
        return ""

    def weaken(self, node: Any) -> bool:
        """Subscribe again so that all publishers of the topic's type match; return False if that is not possible.

        Messages sent between the two subscriptions are lost, and counted.
        """
        publishers = node.get_publishers_info_by_topic(self.name)
        same = offers([one for one in publishers if one.topic_type == self.type_name])
        request = to_request((*same, self.request))
        if self.fixed or request == self.request:
            return False
        while self.take_pending() is not None:
            pass
        node.destroy_subscription(self._subscription)
        self.request = request
        self.subscribe(node, self._receive)
        return True
