"""The node ``recorder``: records topics to a rosbag2 MCAP bag, with the offered QoS and the number of lost messages."""

from __future__ import annotations

import datetime
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from diagnostic_msgs.msg import DiagnosticStatus
from std_srvs.srv import Trigger

from diffbot_bag.bag import PARAMETERS
from diffbot_bag.bag_files import FileLimits
from diffbot_bag.conversions import message_class, offers, type_hash
from diffbot_bag.metadata import LOST
from diffbot_bag.node_parameters import NodeParameters
from diffbot_bag.parameters import RecorderConfig
from diffbot_bag.qos import read_overrides, to_request
from diffbot_bag.recorded_topic import Receive, RecordedTopic
from diffbot_bag.topic_selection import selection_of
from diffbot_bag.writer import CHUNK_SIZE, BagWriteError, BagWriter
from diffbot_core.errors import DiffbotError
from diffbot_core.ros.node import DiffbotNode, status_message
from diffbot_core.ros.qos import LATCHED
from diffbot_core.ros.run import run
from diffbot_core.stamps import NS_PER_S

POLL_PERIOD = 0.1
"""[s] time between two checks of the topics and publishers of the graph"""
STATUS_PERIOD = 0.5
"""[s] longest time between two ~/status messages, and time between two checks of the disk"""
MIN_FREE_SPACE = 64 * 1024**2
"""[bytes] Recording ends if the disk has less free space."""
QUIET = 0.05
"""[s] At the end, the recorder stops waiting for queued messages after this time without a message."""
MAX_WAIT = 1.0
"""[s] longest wait for queued messages: if the clock of a publisher is behind, all its messages seem to be older"""


class HeldMessage(NamedTuple):
    """A message that waits for the first /clock: the arguments of BagWriter.write."""

    channel: int
    data: bytes
    log_time: int
    publish_time: int
    sequence: int


class RecorderNode(DiffbotNode[RecorderConfig]):
    """Subscribes to each selected topic that has a publisher and writes its messages."""

    qos_by_parameters = False

    def __init__(self, **node_options: Any) -> None:
        """Create the bag and subscribe to the topics of the graph.

        Raises:
            DiffbotError: if a parameter is not allowed or the bag cannot be created.
        """
        super().__init__("recorder", RecorderConfig, **node_options)
        config, namespace = self.config, self.get_namespace()
        try:
            self._overrides = read_overrides(config.qos_profile_overrides_path, namespace)
            self._writer = self._make_writer()
        except DiffbotError:
            self.destroy_node()
            raise
        self._selection = selection_of(config, namespace, config.include_hidden_topics)
        self._topics: dict[str, RecordedTopic] = {}
        self._ignored: set[str] = set()
        """topics that are not selected"""
        self._refused: set[str] = set()
        """selected topics that cannot be recorded"""
        self._paused, self._simulated = config.start_paused, bool(self.get_parameter("use_sim_time").value)
        self._held: list[HeldMessage] = []
        self._held_bytes = self._unwritten = 0
        self._max_delay = 0
        """[ns] longest time from the reception of a message to its writing"""
        self._error_reported = False
        self._status = self.create_publisher(DiagnosticStatus, "~/status", LATCHED)
        self._last_matched: tuple[str, ...] = ("",)
        self._node_parameters = NodeParameters(
            self, lambda data: self._writer.attach(PARAMETERS, "application/json", data)
        )
        self._offer_services()
        self.get_logger().info(f"recording to {self._writer.folder}")
        self._start_timers()

    def _make_writer(self) -> BagWriter:
        config = self.config
        name = config.uri or datetime.datetime.now().strftime("rosbag2_%Y_%m_%d-%H_%M_%S")
        limits = FileLimits(config.max_bag_size, round(config.max_bag_duration * NS_PER_S), config.max_bag_files)
        return BagWriter(
            Path(name),
            chunk_size=min(CHUNK_SIZE, config.max_bag_size or CHUNK_SIZE),
            compression=config.compression,
            limits=limits,
            max_backlog=config.max_cache_size,
        )

    def _start_timers(self) -> None:
        work: list[tuple[float, Callable[[], None]]] = [
            (POLL_PERIOD, self.update_subscriptions),
            (self.config.flush_period, self._flush),
            (STATUS_PERIOD, self._check_and_report),
        ]
        if self.config.record_parameters:
            work.append((POLL_PERIOD, self._node_parameters.poll))
        for period, task in work:
            self.create_timer(period, self._unless_failed(task), clock=self.steady_clock)
        # An exception of the first update must not leave the constructor, because then the bag would not be closed.
        self.contained(self._unless_failed(self.update_subscriptions), "the first search for topics")()

    def _unless_failed(self, task: Callable[[], None]) -> Callable[[], None]:
        """Return a function that calls ``task`` while the bag is open, and ends the recording if writing fails."""

        def guarded() -> None:
            if self._writer.closed:
                return
            try:
                task()
            except BagWriteError as error:
                self._fail(error)

        return guarded

    def _fail(self, error: BagWriteError) -> None:
        if self._error_reported:
            return
        if self._writer.closed:
            self._unwritten += self._writer.unflushed
        self.get_logger().error(str(error))
        self._error_reported = True
        self._publish_status()
        self.finish(1)

    def update_subscriptions(self) -> None:
        """Subscribe to new topics of the graph, and again to topics whose subscription does not match a publisher."""
        for name, types in self.get_topic_names_and_types():
            if name in self._topics or name in self._ignored | self._refused or name == self._status.topic_name:
                continue
            if not self._selection.selects(name):
                self._ignored.add(name)
            elif len(types) == 1:
                self._start(name, types[0])
            # Some of the types may be of subscribers, which do not matter.
            elif len(published := {one.topic_type for one in self.get_publishers_info_by_topic(name)}) > 1:
                self._refuse(name, f"it has several types ({', '.join(sorted(published))})")
            elif published:
                self._start(name, published.pop())
        has_changed = False
        for topic in self._topics.values():
            has_changed = topic.check_publishers() or has_changed
            topic.losses.note_publishers()
            self._writer.note_publishers(topic.channel, topic.losses.publishers)
            self.health.accepted[topic.name] = topic.received
            if topic.losses.lost:
                self.health.dropped[topic.name, "lost"] = topic.losses.lost
            else:  # the counter may have subtracted a suspected gap
                self.health.dropped.pop((topic.name, "lost"), None)
        if has_changed or self._matched() != self._last_matched:
            self._publish_status()

    def _refuse(self, name: str, reason: str) -> None:
        self._refused.add(name)
        self.get_logger().warning(f"{name} is not recorded: {reason}")

    def _start(self, name: str, type_name: str) -> None:
        publishers = self.get_publishers_info_by_topic(name)
        if not publishers:
            return
        try:
            message_class(type_name)
        except DiffbotError as error:
            self._refuse(name, str(error))
            return
        # If the middleware raises an error, the topic stays refused: every new attempt would add a channel.
        self._refused.add(name)
        offered, override = offers(publishers), self._overrides.get(name)
        channel = self._writer.add_topic(name, type_name, offered, type_hash(publishers))
        topic = RecordedTopic(self, name, type_name, channel, override or to_request(offered), override is not None)
        topic.subscribe(self._receiver(topic))
        self._topics[name] = topic
        self._refused.discard(name)
        self.get_logger().info(f"subscribed to {name} [{type_name}]")

    def _receiver(self, topic: RecordedTopic) -> Receive:
        """Return the callback of a topic. It calls few functions: each call takes 1 % of a core at 8 kHz."""
        writer, write = self._writer, self._writer.write
        note, channel, now = topic.losses.note, topic.channel, time.time_ns

        def receive(data: bytes, info: dict[str, Any]) -> None:
            if writer.closed:
                self._unwritten += 1
                return
            if (number := info["publication_sequence_number"]) is None:
                number = 0
            else:
                note(number)
            received = info["received_timestamp"] or now()
            try:
                if self._paused or self._simulated:
                    message = HeldMessage(channel, data, received, info["source_timestamp"], number)
                    topic.received += self._write_or_hold(topic, message)
                else:
                    write(channel, data, received, info["source_timestamp"], number)
                    topic.received += 1
            except BagWriteError as error:
                self._unwritten += 1
                self._fail(error)
            if (delay := now() - received) > self._max_delay:
                self._max_delay = delay

        return receive

    def _write_or_hold(self, topic: RecordedTopic, message: HeldMessage) -> bool:
        """Write a message with simulated time, or hold it until the first /clock; return False if it is dropped.

        Latched messages are also recorded during a pause, since they are needed to interpret later messages.
        """
        if self._paused and not self._writer.is_latched(topic.channel):
            self.health.counted[f"{topic.name} not recorded during a pause"] += 1
            return False
        if not self._simulated:
            self._writer.write(*message)
        elif sim_time := self.get_clock().now().nanoseconds:
            self._release(sim_time)
            self._writer.write(*message._replace(log_time=sim_time))
        elif self._held_bytes + len(message.data) > self.config.max_cache_size:
            topic.dropped += 1
            self.health.drop(topic.name, "no /clock yet")
            return False
        else:
            # With a log time of 0, the bag would seem to be decades long.
            self._held.append(message)
            self._held_bytes += len(message.data)
        return True

    def _release(self, sim_time: int) -> None:
        """Write the held messages with a simulated time [ns] as log time; 0: with their times of reception."""
        held, self._held, self._held_bytes = self._held, [], 0
        for message in held:
            self._writer.write(*(message._replace(log_time=sim_time) if sim_time else message))

    def _flush(self) -> None:
        if self._held and (sim_time := self.get_clock().now().nanoseconds):
            self._release(sim_time)
        self._writer.custom_data = self._custom_data()
        self._writer.flush()

    def _check_and_report(self) -> None:
        self._writer.check_disk(MIN_FREE_SPACE)
        self._publish_status()

    def _matched(self) -> tuple[str, ...]:
        """Return the topics with a matched publisher.

        A topic counts from its second check on, since a publisher is matched later than the subscription.
        """
        return tuple(
            sorted(topic.name for topic in self._topics.values() if topic.checks > 1 and topic.publisher_count())
        )

    def _lost(self) -> int:
        return self._unwritten + sum(topic.lost for topic in self._topics.values())

    def _state(self) -> str:
        if self._error_reported:
            return "write error"
        if self._writer.closed:
            return "closed"
        if self._paused:
            return "paused"
        is_waiting = self._simulated and self.get_clock().now().nanoseconds == 0
        return "waiting for /clock" if is_waiting or self._held else "recording"

    def _publish_status(self) -> None:
        self._last_matched = self._matched()
        lost, state = self._lost(), self._state()
        incomplete = sorted(self._refused.union(topic.name for topic in self._topics.values() if topic.unmatched))
        level = DiagnosticStatus.WARN if lost or incomplete else DiagnosticStatus.OK
        if state == "write error":
            level = DiagnosticStatus.ERROR
        values = {
            "uri": str(self._writer.folder),
            "file": self._writer.path.name,
            "topics": " ".join(self._last_matched),
            "messages": str(self._writer.count),
            "lost": str(lost),
            "incomplete": " ".join(incomplete),
            "held": str(len(self._held)),
            "delay": f"{self._max_delay / NS_PER_S:.6f}",
        }
        self._status.publish(status_message(self.get_fully_qualified_name(), level[0], state, values))

    def _offer_services(self) -> None:
        """Offer the services of rosbag2 that do not need arguments, as Triggers."""

        def split() -> tuple[bool, str]:
            name = self._writer.path.name
            self._writer.custom_data = self._custom_data()
            return (True, f"{name} is complete") if self._writer.split() else (False, f"{name} does not have messages")

        def pause(paused: bool) -> tuple[bool, str]:
            self._paused = paused
            return is_paused()

        def is_paused() -> tuple[bool, str]:
            return True, "paused" if self._paused else "recording"

        actions: dict[str, Callable[[], tuple[bool, str]]] = {
            "split_bagfile": split,
            "pause": lambda: pause(True),
            "resume": lambda: pause(False),
            "is_paused": is_paused,
        }
        for name, action in actions.items():
            self.create_service(Trigger, f"~/{name}", self._answering(action))

    def _answering(self, action: Callable[[], tuple[bool, str]]) -> Callable[[Any, Any], Any]:
        def answer(_request: Any, response: Any) -> Any:
            if self._writer.closed:
                response.success, response.message = False, "the bag is closed"
                return response
            try:
                response.success, response.message = action()
            except BagWriteError as error:
                response.success, response.message = False, str(error)
                self._fail(error)
            self._publish_status()
            return response

        return answer

    def _record_queued(self) -> None:
        """Record messages that were sent before now and are queued or still in transit."""
        now = time.time_ns()
        unfinished = dict(self._topics)
        last_reception = began = time.monotonic()
        while (
            unfinished and not self._writer.closed and time.monotonic() < min(last_reception + QUIET, began + MAX_WAIT)
        ):
            for name, topic in list(unfinished.items()):
                while name in unfinished and (sent := topic.take_queued()) is not None:
                    last_reception = time.monotonic()
                    if sent > now:
                        del unfinished[name]
            time.sleep(QUIET / 10)

    def before_shutdown(self) -> None:
        """Record the messages that were sent before now, close the bag and log the numbers of messages."""
        try:
            self._record_queued()
            if self._held and not self._writer.closed:
                count = len(self._held)
                self.get_logger().warning(f"/clock was not received: {count} messages keep their time of reception")
                self._release(0)
            self._node_parameters.close()
            self._writer.custom_data = self._custom_data()
            self._writer.close()
        except BagWriteError as error:
            self._fail(error)
        if not self._error_reported:
            self._publish_status()
        self.get_logger().info(f"{self._writer.count} messages, {self._lost()} lost, {self._writer.folder}")

    def _custom_data(self) -> dict[str, str]:
        lost = {f"lost {topic.name}": str(topic.lost) for topic in self._topics.values() if topic.lost}
        return {LOST: str(self._lost())} | lost


def main(args: list[str] | None = None) -> int:
    """Run the recorder; return the exit status."""
    return run(RecorderNode, args)


if __name__ == "__main__":
    raise SystemExit(main())
