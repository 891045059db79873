"""Count the messages that a recorder's subscriptions do not receive, for the type or the QoS of their publishers.

One participant of DDS can subscribe to a topic with one type only, so the count needs a second participant. It is made
when the first such publisher appears.
"""

from __future__ import annotations

from typing import Any

import rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from diffbot_bag.bag.qos import to_request
from diffbot_bag.record.lost_messages import GapCounter
from diffbot_bag.ros.conversions import message_class, take_pending, to_ros
from diffbot_bag.ros.recorded_topic import RecordedTopic

_SETTLED_POLLS = 10
"""Polls of a topic after which a publisher that appears is a new one; before, it may have been discovered late."""


class _Counted:
    """Messages of one topic as the second participant receives them."""

    def __init__(self, subscription: Any, baseline: int, from_first: bool) -> None:
        self.subscription, self.baseline, self.from_first = subscription, baseline, from_first
        self.received = self.received_before = self.lost = 0
        self.gaps: GapCounter | None = None

    def drain(self) -> None:
        """Count what was received since the last call; with ``gaps``, what was dropped, and sent before, too."""
        self.received_before = self.received
        while taken := take_pending(self.subscription):
            number = taken[1]["publication_sequence_number"]
            if self.gaps is not None and number is not None:
                missing = self.gaps.note(number)
                self.lost += missing if self.received or not self.from_first else number - 1
            self.received += 1


class UnmatchedMessages:
    """Counts, topic by topic, messages that are not recorded."""

    def __init__(self, node: Node, depth: int) -> None:
        """Count for the recorder ``node``; ``depth`` messages of a topic may wait between two polls."""
        self._node, self._depth = node, depth
        self._observer: Node | None = None
        self._counted: dict[str, _Counted] = {}

    def watch(self, topic: RecordedTopic, recorded: int) -> None:
        """Begin to count for a topic that has an unmatched publisher, ``recorded`` messages of it being in the bag."""
        if topic.name in self._counted:
            return
        try:
            kind = message_class(topic.foreign_type or topic.type_name)
            qos = to_ros(to_request(topic.offers, self._depth))
            subscription = self._participant().create_subscription(kind, topic.name, _ignore, qos, raw=True)
        except Exception as error:  # types that are not installed, and what rmw raises for a third type
            reason = " ".join(str(error).split())
            self._node.get_logger().warning(f"{topic.name}: the messages not recorded are not counted: {reason}")
            return
        # A publisher that was there before the recorder has sent messages that nobody expects in the bag.
        counted = _Counted(subscription, recorded, from_first=topic.polls > _SETTLED_POLLS)
        if topic.foreign_type:
            counted.gaps = GapCounter()
        self._counted[topic.name] = counted

    def poll(self) -> None:
        """Take what was received since the last call."""
        for counted in self._counted.values():
            counted.drain()

    def lost(self, topic: RecordedTopic, recorded: int, at_end: bool = False) -> int:
        """Return how many messages of a topic are known to be missing, for the reason of this class.

        Args:
            topic: the topic.
            recorded: messages of it in the bag, and those counted as lost for other reasons.
            at_end: no message of the topic waits for the recorder; before, the newest may.
        """
        if (counted := self._counted.get(topic.name)) is None:
            return 0
        if counted.gaps is not None:
            return counted.received + counted.lost
        received = counted.received if at_end else counted.received_before
        # This subscription matches all publishers, and receives what is recorded, too.
        return max(0, received - (recorded - counted.baseline))

    def close(self) -> None:
        """Leave the graph."""
        if self._observer is not None:
            self._observer.destroy_node()
            rclpy.try_shutdown(context=self._observer.context)

    def _participant(self) -> Node:
        if self._observer is None:
            context = rclpy.Context()
            domain = self._node.context.get_domain_id()
            rclpy.init(args=[], context=context, domain_id=domain, signal_handler_options=SignalHandlerOptions.NO)
            name = f"_{self._node.get_name()}_unmatched"
            self._observer = Node(
                name, namespace=self._node.get_namespace(), context=context, use_global_arguments=False,
                start_parameter_services=False, enable_rosout=False,
            )  # fmt: skip
        return self._observer


def _ignore(_data: bytes) -> None:
    """No executor spins this node: messages are taken by hand."""
