"""The publishers of a replay: their QoS, the wait for subscribers and acknowledgement, and a bound on both."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Collection, Mapping
from typing import Any, NamedTuple

from rclpy._rclpy_pybind11 import RCLError
from rclpy.duration import Duration
from rclpy.exceptions import InvalidTopicNameException
from rclpy.node import Node
from rosgraph_msgs.msg import Clock

from diffbot_bag.bag.metadata import Topic
from diffbot_bag.bag.qos import Qos, to_offer
from diffbot_bag.bag.reader import RawMessage
from diffbot_bag.replay.playback_clock import SECOND
from diffbot_bag.replay.subscribers import POLL, SETTLE, wait_for_subscribers, wait_until_acknowledged
from diffbot_bag.ros import conversions as ros_conversions
from diffbot_bag.ros.patient_outputs import BoundedOutput, KeepingOutput
from diffbot_core.errors import DiffbotError
from diffbot_core.foreign_files import shown
from diffbot_core.ros.node import QUEUE

CLOCK_TOPIC = "/clock"


class Naming(NamedTuple):
    """Names and QoS of the topics to publish."""

    remap: Mapping[str, str]
    """new by old absolute name; others stay"""
    overrides: Mapping[str, Qos]
    """QoS by the topic's name in the bag, in place of what was recorded"""
    max_unacknowledged: int = 0
    """of all topics together; 0: as many as each publisher keeps"""
    patience: float = math.inf
    """[s] longest wait for acknowledgement of a topic; negative: no wait"""


class ReplayOutputs:
    """One publisher for each topic; :meth:`send` waits before a message that is not acknowledged is overwritten."""

    def __init__(self, node: Node, topics: Mapping[str, Topic], naming: Naming, stop: threading.Event) -> None:
        """Create the publishers; topics that cannot be published are logged and left out.

        Args:
            node: their node.
            topics: topics of the bag by name.
            naming: names and QoS.
            stop: ends all waiting when set.
        """
        self._node, self._topics, self._naming, self._stop = node, topics, naming, stop
        self.latched: set[str] = set()
        """Topics whose last message is kept for late subscribers, by their names in the bag."""
        self._publishers: dict[str, Any] = {}
        self._refused: set[str] = set()
        self._patient: dict[str, KeepingOutput | BoundedOutput] = {}
        self._share = max(1, naming.max_unacknowledged // max(1, len(topics)))
        for name, topic in topics.items():
            try:
                self._create(topic, naming.overrides.get(name) or to_offer(topic.qos))
            except (DiffbotError, InvalidTopicNameException, RCLError) as error:
                reason = shown(" ".join(str(error).split()))
                node.get_logger().warning(f"{shown(name)} is not played: {reason}")

    @property
    def names(self) -> Collection[str]:
        """The topics that are published, by their names in the bag."""
        return self._publishers.keys()

    def _create(self, topic: Topic, offer: Qos) -> None:
        naming, share = self._naming, self._share
        if naming.max_unacknowledged:
            offer = bounded(offer, share)
            publisher = self._publish_as(topic, offer)
            self._patient[topic.name] = BoundedOutput(publisher, min(offer.depth, share), self._stop)
        elif (offer.reliability, offer.durability) == ("reliable", "volatile") and naming.patience >= 0.0:
            publisher = self._publish_as(topic, offer._replace(history="keep_all"))
            self._patient[topic.name] = KeepingOutput(publisher, naming.patience, self._stop)
        else:
            self._publish_as(topic, offer)
        if offer.is_latched:
            self.latched.add(topic.name)

    def _publish_as(self, topic: Topic, offer: Qos) -> Any:
        kind = ros_conversions.message_class(topic.type)
        name = self._naming.remap.get(topic.name, topic.name)
        publisher = self._node.create_publisher(kind, name, ros_conversions.to_ros(offer))
        self._publishers[topic.name] = publisher
        return publisher

    def send(self, message: RawMessage) -> None:
        """Publish a message, when there is room for it; without effect once the replay is to stop.

        One that the middleware refuses, as with more bytes than its type can have, is left out; the first is logged.
        """
        try:
            self._send(message)
        except RCLError as error:
            if message.topic not in self._refused:
                self._refused.add(message.topic)
                reason = shown(" ".join(str(error).split()))
                self._node.get_logger().warning(f"{shown(message.topic)}: a message cannot be published: {reason}")

    def _send(self, message: RawMessage) -> None:
        name = message.topic
        patient = self._patient.get(name)
        if patient is None:
            self._publishers[name].publish(message.data)
        elif not patient.send(message.data):
            self._wait_no_more(name)
            self._publishers[name].publish(message.data)

    def _wait_no_more(self, name: str) -> None:
        """Offer the topic anew with its usual history, whose oldest messages are overwritten, and log that."""
        text = f"{shown(name)}: not acknowledged after {self._naming.patience:g} s, messages may be lost from now on"
        self._node.get_logger().warning(text)
        topic = self._topics[name]
        del self._patient[name]
        self._node.destroy_publisher(self._publishers[name])
        self._publish_as(topic, self._naming.overrides.get(name) or to_offer(topic.qos))

    def wait_for_subscribers(self, named: Collection[str], timeout: float) -> set[str]:
        """Wait until the named topics, or all if none is, have a subscriber; return those of them without one."""
        return wait_for_subscribers(self._publishers, set(named) or set(self.names), timeout, self._stop)

    def wait_until_acknowledged(self, timeout: float) -> set[str]:
        """Wait until reliable subscribers have acknowledged everything; return the topics for which that failed."""
        self._stop.wait(SETTLE)
        return wait_until_acknowledged(self._publishers, timeout, Duration(seconds=POLL), self._stop)


def bounded(offer: Qos, share: int) -> Qos:
    """Return a reliable offer whose history, at most ``share`` messages, is full when the replay waits for it."""
    # Latched messages are kept for subscribers that come later, as many as without a bound.
    return offer._replace(reliability="reliable", history="keep_last", depth=offer.depth if offer.is_latched else share)


def clock_sender(node: Node) -> Callable[[int], None]:
    """Return a function that publishes a time [ns] on /clock."""
    publisher = node.create_publisher(Clock, CLOCK_TOPIC, QUEUE)

    def send(time: int) -> None:
        message = Clock()
        message.clock.sec, message.clock.nanosec = divmod(time, SECOND)
        publisher.publish(message)

    return send
