"""Publish the messages of a replay with one publisher per topic, and wait for subscribers."""

from __future__ import annotations

import contextlib
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
from diffbot_bag.definitions import DefinitionNotFoundError, type_hash
from diffbot_bag.metadata import Topic
from diffbot_bag.qos import Qos, to_offer
from diffbot_core.errors import DiffbotError, shown

RCLError = rclpy_implementation.RCLError
CLOCK_TOPIC = "/clock"
MAX_UNACKNOWLEDGED = 200
"""Largest number of unacknowledged messages of all topics together, when playing as fast as possible."""
POLL = 0.02
"""[s] time between two checks of the subscribers"""
SETTLE = 0.25
"""[s] additional wait for events that a publisher cannot observe: its discovery, and the arrival of last messages"""


class Publications:
    """One publisher for each topic of a bag."""

    def __init__(
        self, node: Node, topics: Mapping[str, Topic], overrides: Mapping[str, Qos], *, bounded: bool = False
    ) -> None:
        """Create the publishers; log the topics that cannot be published.

        Args:
            node: node of the publishers.
            topics: topics of the bag by name.
            overrides: QoS by the name of the topic in the bag, which replaces the recorded QoS.
            bounded: wait for acknowledgement after each MAX_UNACKNOWLEDGED messages.
        """
        self.stop = threading.Event()
        """ends all waits when it is set"""
        self.latched: set[str] = set()
        """names in the bag of the topics whose last messages are kept for late subscribers"""
        self._node = node
        self._publishers: dict[str, Any] = {}
        self._depth = max(1, MAX_UNACKNOWLEDGED // max(1, len(topics))) if bounded else 0
        self._unacknowledged = dict.fromkeys(topics, 0)
        self._refused: set[str] = set()
        for topic in topics.values():
            try:
                self._create(topic, overrides.get(topic.name) or to_offer(topic.qos))
            except (DiffbotError, InvalidTopicNameException, RCLError) as error:
                self._warn(f"{topic.name} is not played: {error}")

    def _create(self, topic: Topic, offer: Qos) -> None:
        if topic.encoding != CDR:
            raise DiffbotError(f"its encoding is {shown(topic.encoding)}: must be {CDR}")
        if self._depth:
            # If the history is full, DDS requests acknowledgement at once, not at its next heartbeat. A latched topic
            # keeps its depth, which is the number of messages for late subscribers.
            depth = offer.depth if offer.is_latched else self._depth
            offer = offer._replace(reliability="reliable", history="keep_last", depth=depth)
        kind = message_class(topic.type)
        self._publishers[topic.name] = self._node.create_publisher(kind, topic.name, to_ros(offer))
        if offer.is_latched:
            self.latched.add(topic.name)
        with contextlib.suppress(DefinitionNotFoundError):
            if topic.type_hash and topic.type_hash != type_hash(topic.type):
                reason = f"{topic.type} was recorded with another definition than the installed one"
                self._warn(f"{topic.name}: subscribers may receive wrong values: {reason}")

    def _warn(self, text: str) -> None:
        self._node.get_logger().warning(shown(" ".join(text.split())))

    @property
    def names(self) -> Collection[str]:
        """Names in the bag of the topics that are published."""
        return self._publishers.keys()

    def send(self, message: RawMessage) -> None:
        """Publish a message, unless ``stop`` is set.

        A message that the middleware refuses is dropped, for example if it is longer than its type allows. The first
        one of each topic is logged.
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
                self._warn(f"{name}: a message cannot be published (logged once): {error}")

    def wait_for_subscribers(self, timeout: float) -> None:
        """Wait until each topic has a subscriber, for at most ``timeout`` [s].

        A publisher discovers a subscriber before the subscriber discovers it, so this method waits SETTLE longer.
        """
        missing = self._wait(lambda publisher: publisher.get_subscription_count() > 0, timeout)
        if len(missing) < len(self._publishers):
            self.stop.wait(SETTLE)

    def wait_until_acknowledged(self, timeout: float) -> set[str]:
        """Wait until reliable subscribers have acknowledged all messages, for at most ``timeout`` [s].

        Returns:
            Topics with messages that are not acknowledged.
        """
        self.stop.wait(SETTLE)
        return self._wait(lambda publisher: publisher.wait_for_all_acked(Duration(seconds=POLL)), timeout)

    def _wait(self, is_ready: Callable[[Any], bool], timeout: float) -> set[str]:
        """Wait until all publishers are ready, for at most ``timeout`` [s]; return the topics that are not ready."""
        missing, deadline = set(self._publishers), time.monotonic() + timeout
        while not self.stop.is_set():
            missing = {name for name in missing if not is_ready(self._publishers[name])}
            if not missing or time.monotonic() >= deadline:
                break
            self.stop.wait(POLL)
        return missing
