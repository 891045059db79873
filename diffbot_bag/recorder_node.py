"""The node ``recorder``: writes the messages of topics, their times, offered QoS and losses to a rosbag2 MCAP bag."""

from __future__ import annotations

if __name__ == "__main__":  # before the imports that take long: see launcher
    from diffbot_core.launcher import launch

    raise SystemExit(launch("diffbot_bag.recorder_node"))

import datetime
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus

from diffbot_bag import ros_conversions
from diffbot_bag.parameters import RecorderConfig
from diffbot_bag.pending_messages import Held, HeldMessages
from diffbot_bag.qos import to_request
from diffbot_bag.recording.mcap_writer import Compression
from diffbot_bag.ros.recorded_topic import RecordedTopic
from diffbot_bag.ros.unmatched_messages import UnmatchedMessages
from diffbot_bag.topic_selection import TopicSelection, absolute
from diffbot_bag.writer import BagWriteError, BagWriter
from diffbot_core.errors import DiffbotError
from diffbot_core.ros.node import LATCHED, DiffbotNode, run, status_message

STATUS_PERIOD = 0.5
"""[s] between two ~/status messages while only counts change"""
WATCH_PERIOD = 0.5
"""[s] between two looks at the free space and at the file"""
QUIET = 0.05
"""[s] without a message after which, at the end, no more are expected"""


class RecorderNode(DiffbotNode[RecorderConfig]):
    """Subscribes to each selected topic that has a publisher and writes its messages."""

    qos_by_parameters = False

    def __init__(self) -> None:
        """Create the bag and subscribe to the topics present.

        Raises:
            DiffbotError: if a parameter is not allowed or the bag cannot be created.
        """
        super().__init__("recorder", RecorderConfig)
        try:
            self._selection = self._make_selection()
            self._writer = self._make_writer()
        except DiffbotError:
            self.destroy_node()
            raise
        self._topics: dict[str, RecordedTopic] = {}
        self._refused: set[str] = set()
        self._unwritten = 0
        self._unmatched = UnmatchedMessages(self, self.config.depth)
        self._at_end = False
        self._status = self.create_publisher(DiagnosticStatus, "~/status", LATCHED)
        self._last_status: tuple[str, ...] = ("",)
        self._state = "recording"
        self._use_sim_time = bool(self.get_parameter("use_sim_time").value)
        self._held = HeldMessages(self.config.max_held)
        if self._use_sim_time:
            self._state = "waiting for /clock"
        for period, work in (
            (self.config.topic_polling_interval, self.update_subscriptions),
            (self.config.flush_period, self._flush),
            (STATUS_PERIOD, self._publish_status),
            (WATCH_PERIOD, lambda: self._writer.check_disk(self.config.min_free_space)),
        ):
            self.create_timer(period, self._unless_failed(work), clock=self.steady_clock)
        self.get_logger().info(f"recording to {self._writer.folder}")
        self.update_subscriptions()

    def _make_selection(self) -> TopicSelection:
        config, namespace = self.config, self.get_namespace()
        selection = TopicSelection(
            topics=tuple(absolute(name, namespace) for name in config.topics),
            regex=config.regex,
            exclude_topics=tuple(absolute(name, namespace) for name in config.exclude_topics),
            exclude_regex=config.exclude_regex,
            include_hidden_topics=config.include_hidden_topics,
        )
        selection.check()
        return selection

    def _make_writer(self) -> BagWriter:
        name = self.config.uri or datetime.datetime.now().strftime("rosbag2_%Y_%m_%d-%H_%M_%S")
        return BagWriter(
            Path(name),
            chunk_size=self.config.chunk_size,
            compression=Compression(self.config.compression),
        )

    def _unless_failed(self, work: Callable[[], None]) -> Callable[[], None]:
        def guarded() -> None:
            if self._writer.closed:
                return
            try:
                work()
            except BagWriteError as error:
                self._fail(error)

        return guarded

    def _fail(self, error: BagWriteError) -> None:
        if self._writer.closed and self._state != "write error":
            self._unwritten += self._writer.unflushed
        self.get_logger().error(str(error))
        self._state = "write error"
        self._publish_status()
        self.finish(1)

    def update_subscriptions(self) -> None:
        """Subscribe to new topics of the graph; called at each polling interval."""
        own = self._status.topic_name
        for name, types in self.get_topic_names_and_types():
            if name in self._topics or name in self._refused or name == own:
                continue
            if not self._selection.selects(name):
                self._refused.add(name)
            elif len(types) > 1:
                self._refuse(name, f"has several types ({', '.join(types)})")
            else:
                self._subscribe(name, types[0])
        self._unmatched.poll()
        for topic in self._topics.values():
            self._note_unmatched(topic, topic.update(self))
        if self._subscribed() != self._last_status:
            self._publish_status()

    def _note_unmatched(self, topic: RecordedTopic, found: dict[str, str]) -> None:
        for name, reason in found.items():
            self.get_logger().warning(f"{topic.name}: {name} is not recorded: {reason}")
        if found:
            self._unmatched.watch(topic, self._counted(topic))
            self._publish_status()
        if missing := self._unmatched.lost(topic, self._counted(topic)):
            self.health.dropped[topic.name, "publisher not matched"] = missing

    def _refuse(self, name: str, reason: str) -> None:
        self._refused.add(name)
        self.get_logger().warning(f"{name} is not recorded: it {reason}")

    def _subscribe(self, name: str, type_name: str) -> None:
        publishers = self.get_publishers_info_by_topic(name)
        if not publishers:
            return
        try:
            message_class = ros_conversions.message_class(type_name)
        except DiffbotError as error:
            self._refuse(name, f"has a type that cannot be loaded: {error}")
            return
        offered = ros_conversions.offers(publishers)
        request = to_request(offered, self.config.depth)
        channel = self._writer.add_topic(name, type_name, offered, ros_conversions.type_hash(publishers))
        topic = RecordedTopic(name, type_name, channel, request)
        topic.gaps.publishers = len(publishers)
        topic.subscription = self.create_subscription(
            message_class,
            name,
            ros_conversions.with_info(self._receiver(topic)),
            ros_conversions.to_ros(request),
            raw=True,
        )
        self._topics[name] = topic
        self.get_logger().info(f"subscribed to {name} [{type_name}]")

    def _subscribed(self) -> tuple[str, ...]:
        """Return topics with a matched publisher, a poll after subscribing: the publisher is matched by then, too."""
        return tuple(
            sorted(
                topic.name
                for topic in self._topics.values()
                if topic.polls > 1 and topic.subscription.get_publisher_count() > 0
            )
        )

    def _receiver(self, topic: RecordedTopic) -> Callable[[bytes, dict[str, Any]], None]:
        accepted, writer = self.health.accepted, self._writer

        def receive(data: bytes, info: dict[str, Any]) -> None:
            if writer.closed:
                self._unwritten += 1
                return
            number = info["publication_sequence_number"]
            if number is not None and topic.gaps.note(number):
                self.health.dropped[topic.name, "lost"] = topic.gaps.lost
            accepted[topic.name] += 1
            received = info["received_timestamp"] or time.time_ns()
            message = Held(topic.channel, data, received, info["source_timestamp"], number or 0)
            try:
                if self._use_sim_time:
                    self._write_in_simulated_time(message, topic.name)
                else:
                    writer.write(*message.at(received))
            except BagWriteError as error:
                self._unwritten += 1
                self._fail(error)

        return receive

    def _write_in_simulated_time(self, message: Held, topic: str) -> None:
        now = self.get_clock().now().nanoseconds
        if now == 0:
            if not self._held.hold(message):
                self.health.drop(topic, "no /clock yet")
            return
        if self._held:
            self._release(now)
        self._writer.write(*message.at(now))

    def _release(self, now: int | None) -> None:
        for message in self._held.release():
            self._writer.write(*message.at(message.received if now is None else now))
        self._state = "recording"

    def _flush(self) -> None:
        if self._held and (now := self.get_clock().now().nanoseconds):
            self._release(now)
        self._writer.flush()

    def _counted(self, topic: RecordedTopic) -> int:
        return self.health.accepted[topic.name] + topic.gaps.lost

    def _lost_of(self, topic: RecordedTopic) -> int:
        return topic.gaps.lost + self._unmatched.lost(topic, self._counted(topic), self._at_end)

    def _lost(self) -> int:
        return self._unwritten + sum(map(self._lost_of, self._topics.values()))

    def _publish_status(self) -> None:
        self._last_status = self._subscribed()
        lost = self._lost()
        incomplete = sorted(topic.name for topic in self._topics.values() if topic.unmatched)
        level = DiagnosticStatus.WARN if lost or incomplete else DiagnosticStatus.OK
        if self._state == "write error":
            level = DiagnosticStatus.ERROR
        values = {
            "uri": str(self._writer.folder),
            "topics": " ".join(self._last_status),
            "messages": str(self._writer.count),
            "lost": str(lost),
            "incomplete": " ".join(incomplete),
            "held": str(len(self._held)),
        }
        self._status.publish(status_message(self.get_fully_qualified_name(), level[0], self._state, values))

    def before_shutdown(self) -> None:
        """Write what was sent before now, close the bag and log the counts."""
        try:
            self._take_pending()
            self._unmatched.poll()
            self._at_end = True
            if self._held and not self._writer.closed:
                self.get_logger().warning(
                    f"no /clock received: {len(self._held)} messages keep their time of reception"
                )
                self._release(None)
            self._writer.close(self._custom_data())
        except BagWriteError as error:
            self._fail(error)
        if self._state != "write error":
            self._state = "closed"
            self._publish_status()
        self._unmatched.close()
        self.get_logger().info(f"{self._writer.count} messages, {self._lost()} lost, {self._writer.folder}")

    def _take_pending(self) -> None:
        """Write messages sent before now that are queued or still in transit."""
        stop = time.time_ns()
        receivers = {topic.name: self._receiver(topic) for topic in self._topics.values()}
        last = time.monotonic()
        while receivers and not self._writer.closed and time.monotonic() - last < QUIET:
            for name, receive in list(receivers.items()):
                while name in receivers and (taken := ros_conversions.take_pending(self._topics[name].subscription)):
                    receive(*taken)
                    last = time.monotonic()
                    if taken[1]["source_timestamp"] > stop:
                        del receivers[name]
            time.sleep(QUIET / 10)

    def _custom_data(self) -> dict[str, str]:
        lost = {topic.name: self._lost_of(topic) for topic in self._topics.values()}
        return {"lost_messages": str(self._lost())} | {f"lost {name}": str(n) for name, n in lost.items() if n}


def main(args: list[str] | None = None) -> int:
    """Run the recorder; return the exit status."""
    return run(RecorderNode, args)
