"""The publishers of a replay, one per topic, and the waits for their subscribers."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Collection, Mapping
from typing import Any

from rclpy.duration import Duration
from rclpy.exceptions import InvalidTopicNameException
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node

from diffbot_bag.bag import CDR, RawMessage
from diffbot_bag.conversions import message_class, to_ros
from diffbot_bag.metadata import Topic
from diffbot_bag.qos import Qos, to_offer
from diffbot_core.errors import DiffbotError, shown

RCLError = rclpy_implementation.RCLError
CLOCK_TOPIC = "/clock"
MAX_UNACKNOWLEDGED = 200
"""Messages of all topics together that reliable subscribers may not have acknowledged, as fast as possible."""
POLL = 0.02
"""[s] between two checks of the subscribers"""
SETTLE = 0.25
"""[s] allowance for discovery and last messages to reach the subscribers, which publishers cannot observe"""


class Publications:
    """One publisher for each topic of a bag."""

    def __init__(
        self, node: Node, topics: Mapping[str, Topic], overrides: Mapping[str, Qos], *, bounded: bool = False
    ) -> None:
        """Create the publishers; topics that cannot be published are logged and left out.

        Args:
            node: of the publishers.
            topics: topics of the bag by name.
            overrides: QoS by the topic's name in the bag, in place of the recorded QoS.
            bounded: wait for acknowledgement whenever MAX_UNACKNOWLEDGED messages were sent.
        """
        self.stop = threading.Event()
        """ends all waiting when set"""
        self.latched: set[str] = set()
        """topics whose last message is kept for late subscribers, by their names in the bag"""
        self._node = node
        self._publishers: dict[str, Any] = {}
        self._depth = max(1, MAX_UNACKNOWLEDGED // max(1, len(topics))) if bounded else 0
        self._unacknowledged = dict.fromkeys(topics, 0)
        self._refused: set[str] = set()
        for topic in topics.values():
            try:
                self._create(topic, overrides.get(topic.name) or to_offer(topic.qos))
            except (DiffbotError, InvalidTopicNameException, RCLError) as error:
                self._warn(topic.name, f"is not played: {error}")

    def _create(self, topic: Topic, offer: Qos) -> None:
        if topic.encoding != CDR:
            raise DiffbotError(f"its encoding is {shown(topic.encoding)}, and ROS 2 messages are {CDR}")
        if self._depth:
            # A full history makes DDS ask for acknowledgement at once instead of at its next heartbeat. As many latched
            # messages are kept for late subscribers as without a bound.
            depth = offer.depth if offer.is_latched else self._depth
            offer = offer._replace(reliability="reliable", history="keep_last", depth=depth)
        kind = message_class(topic.type)
        self._publishers[topic.name] = self._node.create_publisher(kind, topic.name, to_ros(offer))
        if offer.is_latched:
            self.latched.add(topic.name)

    def _warn(self, topic: str, text: str) -> None:
        self._node.get_logger().warning(f"{shown(topic)} {shown(' '.join(text.split()))}")

    @property
    def names(self) -> Collection[str]:
        """The topics that are published, by their names in the bag."""
        return self._publishers.keys()

    def send(self, message: RawMessage) -> None:
        """Publish a message; without effect once the replay is to stop.

        A message that the middleware refuses, such as one with more bytes than its type can have, is left out; the
        first one of a topic is logged.
        """
        name, publisher = message.topic, self._publishers[message.topic]
        if self._depth:
            if self._unacknowledged[name] >= self._depth:
                while not publisher.wait_for_all_acked(Duration(seconds=POLL)) and not self.stop.is_set():
                    pass
                self._unacknowledged[name] = 0
            self._unacknowledged[name] += 1
        if self.stop.is_set():
            return
        try:
            publisher.publish(message.data)
        except RCLError as error:
            if name not in self._refused:
                self._refused.add(name)
                self._warn(name, f"has a message that cannot be published: {error}")

    def wait_for_subscribers(self, timeout: float) -> None:
        """Wait until each topic has a subscriber, ``timeout`` [s] at most.

        A publisher is matched a moment before its subscriber is, hence the additional wait of SETTLE.
        """
        missing = self._wait(lambda publisher: publisher.get_subscription_count() > 0, timeout)
        if len(missing) < len(self._publishers):
            self.stop.wait(SETTLE)

    def wait_until_acknowledged(self, timeout: float) -> set[str]:
        """Wait until reliable subscribers have acknowledged all messages, ``timeout`` [s] at most.

        Returns:
            Topics with messages that are not acknowledged.
        """
        self.stop.wait(SETTLE)
        return self._wait(lambda publisher: publisher.wait_for_all_acked(Duration(seconds=POLL)), timeout)

    def _wait(self, is_ready: Callable[[Any], bool], timeout: float) -> set[str]:
        """Wait for all publishers, ``timeout`` [s] at most; return the topics of those that are not ready."""
        missing, deadline = set(self._publishers), time.monotonic() + timeout
        while not self.stop.is_set():
            missing = {name for name in missing if not is_ready(self._publishers[name])}
            if not missing or time.monotonic() >= deadline:
                break
            self.stop.wait(POLL)
        return missing
