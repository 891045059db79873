"""Subscribe to one topic to record, count its losses, and adapt its QoS to publishers that join later."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

from diffbot_bag.conversions import from_ros, message_class, offers, to_ros
from diffbot_bag.losses import LossCounter
from diffbot_bag.qos import Qos, to_request
from diffbot_core.ros.graph import full_name

Receive = Callable[[bytes, dict[str, Any]], None]
_BEST_EFFORT, _VOLATILE = "its reliability is best effort", "its durability is volatile"


class RecordedTopic:
    """A topic with its channel in the bag, its subscription and its losses."""

    def __init__(self, node: Any, name: str, type_name: str, channel: int, request: Qos, fixed: bool) -> None:
        """Start without a subscription. ``request`` is its QoS; if ``fixed``, it is not adapted to publishers."""
        self._node = node
        self.name, self.type_name, self.channel, self.request, self.fixed = name, type_name, channel, request, fixed
        self.losses = LossCounter(self.publisher_count)
        self.received = 0
        """number of received messages that are recorded, or wait for /clock"""
        self.dropped = 0
        """number of messages that were dropped because too many of them waited for /clock"""
        self.checks = 0
        """number of calls of :meth:`check_publishers`"""
        self.unmatched: dict[str, str] = {}
        """reason why a publisher is not recorded, by the name of its node"""
        self._subscription: Any = None
        self._subscription_number = 0
        self._receive: Receive = lambda _data, _info: None

    @property
    def lost(self) -> int:
        """Number of lost messages."""
        return self.losses.lost + self.dropped

    def publisher_count(self) -> int:
        """Return the number of matched publishers."""
        return int(self._subscription.get_publisher_count())

    def subscribe(self, receive: Receive) -> None:
        """Subscribe to the raw messages; ``receive`` is called with the bytes and the info of each message."""
        self._receive = receive
        self._subscription_number = number = self._subscription_number + 1

        def adapted(data: Any, info: Any = None) -> None:
            if info is None:
                # The EventsExecutor of rclpy 7.1.6 passes one tuple, other executors pass two arguments.
                data, info = data
            # An executor may still call the callback of a destroyed subscription.
            if number == self._subscription_number:
                receive(data, info)

        # rclpy inspects the signature to decide whether to pass the info.
        adapted.__signature__ = inspect.signature(receive)  # type: ignore[attr-defined]
        kind, qos = message_class(self.type_name), to_ros(self.request)
        self._subscription = self._node.create_subscription(kind, self.name, adapted, qos, raw=True)

    def take_queued(self) -> int | None:
        """Receive one message from the queue; return the time [ns] of its sending or reception, or None without one.

        The earlier time is returned. If the clock of the publisher is ahead, this is the time of the reception.
        """
        with self._subscription.handle:
            taken = self._subscription.handle.take_message(self._subscription.msg_type, True)
        if taken is None:
            return None
        self._receive(*taken)
        sent, received = (int(taken[1][f"{name}_timestamp"] or 0) for name in ("source", "received"))
        return min(sent, received or sent)

    def check_publishers(self) -> bool:
        """Subscribe again if a publisher offers a weaker QoS; log publishers that are not recorded.

        Return True if a new publisher does not match the subscription, or the reason for a mismatch has changed.
        """
        self.checks += 1
        before, self.unmatched = self.unmatched, {}
        if self._node.count_publishers(self.name) > self.publisher_count():
            publishers = self._node.get_publishers_info_by_topic(self.name)
            reasons = ((full_name(publisher), self._mismatch(publisher)) for publisher in publishers)
            self.unmatched = {name: reason for name, reason in reasons if reason}
        new = {name: reason for name, reason in self.unmatched.items() if before.get(name) != reason}
        is_weaker = any(reason in (_BEST_EFFORT, _VOLATILE) for reason in new.values()) and self._weaken()
        logger = self._node.get_logger()
        for publisher, reason in new.items():
            if is_weaker and reason in (_BEST_EFFORT, _VOLATILE):
                logger.info(f"subscribed to {self.name} again, with the QoS of {publisher}: {reason}")
            else:
                logger.warning(f"{self.name} of {publisher} is not recorded: {reason}")
        return bool(new)

    def _mismatch(self, publisher: Any) -> str:
        """Return why the subscription does not match a publisher; empty if it matches, or discovery is not complete."""
        if publisher.topic_type != self.type_name:
            return f"its type is {publisher.topic_type}, but {self.type_name} is recorded"
        offered = from_ros(publisher.qos_profile)
        if self.request.reliability == "reliable" and offered.reliability == "best_effort":
            return _BEST_EFFORT
        if self.request.durability == "transient_local" and offered.durability == "volatile":
            return _VOLATILE
        return ""

    def _weaken(self) -> bool:
        """Subscribe again with a QoS that matches all publishers of the topic's type; return False if it is fixed.

        Messages that are sent between the two subscriptions are lost, and counted as lost.
        """
        publishers = self._node.get_publishers_info_by_topic(self.name)
        offered = offers([publisher for publisher in publishers if publisher.topic_type == self.type_name])
        request = to_request((*offered, self.request))
        if self.fixed or request == self.request:
            return False
        while self.take_queued() is not None:
            pass
        self._node.destroy_subscription(self._subscription)
        self.request = request
        self.subscribe(self._receive)
        return True
