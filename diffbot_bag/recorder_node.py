"""The node ``recorder``: writes the messages of topics, their times, offered QoS and losses to a rosbag2 MCAP bag."""

from __future__ import annotations

if __name__ == "__main__":  # before the imports that take long: see launcher
    from diffbot_core.launcher import launch

    raise SystemExit(launch("diffbot_bag.recorder_node"))

import datetime
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus

from diffbot_bag.bag.qos_overrides import read_overrides
from diffbot_bag.bag.topic_selection import TopicSelection, absolute
from diffbot_bag.bag.writer import BagWriteError, BagWriter
from diffbot_bag.mcap.attachments import MEDIA_TYPE, PARAMETERS
from diffbot_bag.mcap.whole_chunk import Compression
from diffbot_bag.parameters import RecorderConfig
from diffbot_bag.record.bag_files import FileLimits
from diffbot_bag.record.disk import DiskThread
from diffbot_bag.record.pending_messages import HeldMessages
from diffbot_bag.record.recording import Recording
from diffbot_bag.ros.node_parameters import NodeParameters
from diffbot_bag.ros.recorded_topics import RecordedTopics
from diffbot_bag.ros.recorder_services import RecorderServices
from diffbot_core.errors import DiffbotError
from diffbot_core.ros.node import LATCHED, DiffbotNode, run, status_message

STATUS_PERIOD = 0.5
"""[s] between two ~/status messages while only counts change"""
WATCH_PERIOD = 0.5
"""[s] between two looks at the free space and at the file"""
QUESTION_PERIOD = 0.1
"""[s] between two steps of asking all nodes for their parameters"""
SECOND = 10**9
"""[ns]"""


class RecorderNode(DiffbotNode[RecorderConfig]):
    """Subscribes to each selected topic that has a publisher and writes its messages."""

    qos_by_parameters = False

    def __init__(self, **node_options: Any) -> None:
        """Create the bag and subscribe to the topics present.

        Raises:
            DiffbotError: if a parameter is not allowed or the bag cannot be created.
        """
        super().__init__("recorder", RecorderConfig, **node_options)
        try:
            selection = self._make_selection()
            path = self.config.qos_profile_overrides_path
            overrides = read_overrides(path, self.config.depth, self.get_namespace())
            self._writer = self._make_writer()
        except DiffbotError:
            self.destroy_node()
            raise
        self._writer.describe = self._custom_data
        self._recording = self._make_recording()
        self._topics = RecordedTopics(self, selection, self._writer, self._recording, self._fail, overrides)
        self._status = self.create_publisher(DiagnosticStatus, "~/status", LATCHED)
        self._last_status: tuple[str, ...] = ("",)
        self._error_reported = False
        self._parameters_of_all = NodeParameters(self, partial(self._writer.attach, PARAMETERS, MEDIA_TYPE))
        RecorderServices(self, self._writer, self._recording, self._fail, self._on_service)
        for period, work in self._work():
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
        config = self.config
        name = config.uri or datetime.datetime.now().strftime("rosbag2_%Y_%m_%d-%H_%M_%S")
        writer = BagWriter(
            Path(name),
            chunk_size=config.chunk_size,
            compression=Compression(config.compression, config.compression_level),
            limits=FileLimits(config.max_bag_size, round(config.max_bag_duration * SECOND), config.max_bag_files),
            disk=DiskThread(),
        )
        writer.max_backlog = config.max_cache_size
        return writer

    def _make_recording(self) -> Recording:
        config = self.config
        simulated = bool(self.get_parameter("use_sim_time").value)
        recording = Recording(
            self._writer,
            held=HeldMessages(config.max_held) if simulated else None,
            now=(lambda: self.get_clock().now().nanoseconds) if simulated else None,
        )
        recording.is_paused = config.start_paused
        return recording

    def _work(self) -> list[tuple[float, Callable[[], None]]]:
        """Return the period [s] and the function of each regular task."""
        config, writer = self.config, self._writer
        work = [
            (config.topic_polling_interval, self.update_subscriptions),
            (config.flush_period, self._flush),
            (STATUS_PERIOD, self._publish_status),
            (WATCH_PERIOD, lambda: writer.check_disk(config.min_free_space)),
        ]
        if config.record_parameters:
            work.append((QUESTION_PERIOD, self._parameters_of_all.poll))
        return work

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
        if self._error_reported:
            return
        if self._writer.closed:
            self._topics.unwritten += self._writer.unflushed
        self.get_logger().error(str(error))
        self._error_reported = True
        self._publish_status()
        self.finish(1)

    def _on_service(self) -> None:
        self._topics.is_direct = self._recording.is_direct
        self._publish_status()

    def update_subscriptions(self) -> None:
        """Subscribe to new topics of the graph; called at each polling interval."""
        if self._topics.update(self._status.topic_name) or self._topics.matched() != self._last_status:
            self._publish_status()

    def _flush(self) -> None:
        self._recording.tick()
        self._writer.flush(self.config.fsync)

    def _lost(self) -> int:
        return self._topics.unwritten + sum(self._topics.lost().values())

    def _state(self) -> str:
        if self._error_reported:
            return "write error"
        if self._writer.closed:
            return "closed"
        if self._recording.is_paused:
            return "paused"
        return "waiting for /clock" if self._recording.waits_for_clock else "recording"

    def _publish_status(self) -> None:
        self._last_status = self._topics.matched()
        lost, incomplete, state = self._lost(), self._topics.incomplete(), self._state()
        level = DiagnosticStatus.WARN if lost or incomplete else DiagnosticStatus.OK
        if state == "write error":
            level = DiagnosticStatus.ERROR
        values = {
            "uri": str(self._writer.folder),
            "file": self._writer.path.name,
            "topics": " ".join(self._last_status),
            "messages": str(self._writer.count),
            "lost": str(lost),
            "incomplete": " ".join(incomplete),
            "held": str(self._recording.held),
            "stall": f"{self._topics.stall / SECOND:.6f}",
            "delay": f"{self._topics.delay / SECOND:.6f}",
        }
        self._status.publish(status_message(self.get_fully_qualified_name(), level[0], state, values))

    def before_shutdown(self) -> None:
        """Write what was sent before now, close the bag and log the counts."""
        try:
            self._topics.take_pending()
            if self._recording.held and not self._writer.closed:
                self.get_logger().warning(
                    f"no /clock received: {self._recording.held} messages keep their time of reception"
                )
                self._recording.release(None)
            self._parameters_of_all.close()
            self._writer.close(self._custom_data())
        except BagWriteError as error:
            self._fail(error)
        if not self._error_reported:
            self._publish_status()
        self.get_logger().info(f"{self._writer.count} messages, {self._lost()} lost, {self._writer.folder}")

    def _custom_data(self) -> dict[str, str]:
        lost = self._topics.lost()
        return {"lost_messages": str(self._lost())} | {f"lost {name}": str(n) for name, n in lost.items() if n}


def main(args: list[str] | None = None) -> int:
    """Run the recorder; return the exit status."""
    return run(RecorderNode, args)
