"""The topics that a recorder finds in the graph and subscribes to."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

from diffbot_bag.bag.qos import Qos, to_request
from diffbot_bag.bag.topic_selection import TopicSelection
from diffbot_bag.bag.writer import BagWriteError, BagWriter
from diffbot_bag.record.recording import PAUSED, Recording
from diffbot_bag.ros import conversions as ros_conversions
from diffbot_bag.ros.recorded_topic import Receive, RecordedTopic
from diffbot_core.errors import DiffbotError

QUIET = 0.05
"""[s] without a message after which, at the end, no more are expected"""


class RecordedTopics:
    """Finds topics, subscribes to them and passes their messages to the recording."""

    def __init__(
        self,
        node: Any,
        selection: TopicSelection,
        writer: BagWriter,
        recording: Recording,
        fail: Callable[[BagWriteError], None],
        overrides: Mapping[str, Qos],
    ) -> None:
        """Record the selected topics of ``node``'s graph.

        Args:
            node: the recorder, a DiffbotNode with the parameter ``depth``.
            selection: of topics.
            writer: of the bag.
            recording: takes the messages.
            fail: called when the bag cannot be written.
            overrides: QoS of subscriptions, by topic, whatever the publishers offer.
        """
        self._node, self._selection, self._writer, self._recording = node, selection, writer, recording
        self._fail, self._overrides = fail, overrides
        self._topics: dict[str, RecordedTopic] = {}
        self._refused: set[str] = set()
        self.unwritten = 0
        """messages received that could not be written"""
        self.stall = 0
        """[ns] longest time that the writing of one message kept the node from the next one"""
        self.delay = 0
        """[ns] longest time between the reception of a message by DDS and the end of its writing; DDS itself may hold
        one back, until an earlier one of its publisher was sent again"""
        self.is_direct = recording.is_direct
        """see Recording; to be renewed when it changes"""

    def update(self, own: str) -> bool:
        """Subscribe to new topics, except for ``own``; return whether there is news of unmatched publishers."""
        for name, types in self._node.get_topic_names_and_types():
            if name in self._topics or name in self._refused or name == own:
                continue
            if not self._selection.selects(name):
                self._refused.add(name)
            elif len(types) > 1:
                self._refuse(name, f"has several types ({', '.join(types)})")
            else:
                self._subscribe(name, types[0])
        news = False
        for topic in self._topics.values():
            found = topic.update(self._node)
            news = news or bool(found)
            self._report_unmatched(topic, found)
            self._writer.note_publishers(topic.channel, topic.gaps.publishers)
            self._node.health.accepted[topic.name] = topic.received
        return news

    def _report_unmatched(self, topic: RecordedTopic, found: dict[str, str]) -> None:
        logger = self._node.get_logger()
        for name, reason in found.items():
            if not reason.startswith("its type") and topic.weaken(self._node):
                logger.info(f"{topic.name}: subscribing anew because of {name}: {reason}")
                continue
            logger.warning(f"{topic.name}: {name} is not recorded: {reason}")

    def _refuse(self, name: str, reason: str) -> None:
        self._refused.add(name)
        self._node.get_logger().warning(f"{name} is not recorded: it {reason}")

    def _subscribe(self, name: str, type_name: str) -> None:
        publishers = self._node.get_publishers_info_by_topic(name)
        if not publishers:
            return
        try:
            message_class = ros_conversions.message_class(type_name)
        except DiffbotError as error:
            self._refuse(name, f"has a type that cannot be loaded: {error}")
            return
        offered = ros_conversions.offers(publishers)
        override = self._overrides.get(name)
        request = override or to_request(offered, self._node.config.depth)
        channel = self._writer.add_topic(name, type_name, offered, ros_conversions.type_hash(publishers))
        topic = RecordedTopic(name, type_name, channel, request, fixed=override is not None)
        topic.gaps.publishers = len(publishers)
        topic.subscribe(self._node, message_class, self._receiver(topic))
        self._topics[name] = topic
        self._node.get_logger().info(f"subscribed to {name} [{type_name}]")

    def _receiver(self, topic: RecordedTopic) -> Receive:
        """Return the callback of a topic; in one piece, since at 8 kHz each call inside costs a percent of a core."""
        writer, recording, write, note = self._writer, self._recording, self._writer.write, topic.gaps.note
        channel, now = topic.channel, time.time_ns

        def receive(data: bytes, info: dict[str, Any]) -> None:
            number, published = info["publication_sequence_number"], info["source_timestamp"]
            if topic.seen is not None and not topic.is_first(published, number):
                return
            if writer.closed:
                self.unwritten += 1
                return
            if number is None:
                number = 0
            elif note(number):
                self._node.health.dropped[topic.name, "lost"] = topic.gaps.lost
            begin = now()
            received = info["received_timestamp"] or begin
            topic.received += 1
            try:
                if self.is_direct:
                    write(channel, data, received, published, number)
                elif reason := recording.accept(channel, data, received, published, number):
                    self._leave_out(topic, reason)
            except BagWriteError as error:
                topic.received -= 1
                self.unwritten += 1
                self._fail(error)
            end = now()
            if end - begin > self.stall:  # noqa: PLR1730 - max() takes three times as long
                self.stall = end - begin
            if end - received > self.delay:  # noqa: PLR1730
                self.delay = end - received

        return receive

    def _leave_out(self, topic: RecordedTopic, reason: str) -> None:
        if reason != PAUSED:
            self._node.health.drop(topic.name, reason)

    def matched(self) -> tuple[str, ...]:
        """Return topics with a matched publisher, a poll after subscribing: the publisher is matched by then, too."""
        return tuple(
            sorted(
                topic.name
                for topic in self._topics.values()
                if topic.polls > 1 and topic.subscription.get_publisher_count() > 0
            )
        )

    def incomplete(self) -> list[str]:
        """Return topics with a publisher that is not recorded."""
        return sorted(topic.name for topic in self._topics.values() if topic.unmatched)

    def lost(self) -> dict[str, int]:
        """Return how many messages of each topic are known to be lost before they were received."""
        return {topic.name: topic.gaps.lost for topic in self._topics.values()}

    def take_pending(self) -> None:
        """At the end, record messages sent before now that are queued or still in transit."""
        stop = time.time_ns()
        waiting = dict(self._topics)
        last = time.monotonic()
        while waiting and not self._writer.closed and time.monotonic() - last < QUIET:
            for name, topic in list(waiting.items()):
                while name in waiting and (sent := topic.take_pending()) is not None:
                    last = time.monotonic()
                    if sent > stop:
                        del waiting[name]
            time.sleep(QUIET / 10)
        for topic in self._topics.values():
            topic.finish(self._node)
