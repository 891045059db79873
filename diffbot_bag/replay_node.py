"""The node ``replay``: publishes the messages of a bag with the recorded QoS at the recorded times."""

from __future__ import annotations

if __name__ == "__main__":  # before the imports that take long: see launcher
    from diffbot_core.launcher import launch

    raise SystemExit(launch("diffbot_bag.replay_node"))

import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.duration import Duration
from rclpy.exceptions import InvalidTopicNameException
from rosgraph_msgs.msg import Clock
from std_srvs.srv import Trigger

from diffbot_bag import ros_conversions
from diffbot_bag.chunks import BagLimits
from diffbot_bag.foreign_files import shown
from diffbot_bag.metadata import Topic
from diffbot_bag.parameters import ReplayConfig
from diffbot_bag.playback_clock import SECOND, Window, parse_remap, window
from diffbot_bag.player import Pace, Player
from diffbot_bag.qos import to_offer
from diffbot_bag.reader import BagReader, RawMessage
from diffbot_bag.subscribers import POLL, SETTLE, wait_for_subscribers, wait_until_acknowledged
from diffbot_bag.topic_selection import TopicSelection, absolute
from diffbot_core.errors import DiffbotError, InvalidValueError
from diffbot_core.ros.node import LATCHED, QUEUE, DiffbotNode, run, status_message

STATUS_PERIOD = 0.5
"""[s] between two ~/status messages."""
CLOCK_TOPIC = "/clock"
MAX_CLOCK = 2**31 * SECOND
"""[ns] times that do not fit into builtin_interfaces/Time"""
SWITCH_INTERVAL = 0.0005
"""[s] after which Python switches threads; with the default of 5 ms, reading ahead would delay messages"""


class ReplayNode(DiffbotNode[ReplayConfig]):
    """Publishes the messages of one bag, then exits."""

    qos_by_parameters = False

    def __init__(self) -> None:
        """Open the bag, create a publisher per topic and start to play.

        Raises:
            DiffbotError: if a parameter is not allowed or the bag cannot be read.
        """
        super().__init__("replay", ReplayConfig)
        try:
            self._reader = self._open()
            self._topics = self._selected_topics()
            self._window = self._make_window()
            self._outputs = self._make_publishers()
        except DiffbotError:
            self.destroy_node()
            raise
        self._clock_publisher = self.create_publisher(Clock, CLOCK_TOPIC, QUEUE) if self.config.clock > 0.0 else None
        self._status = self.create_publisher(DiagnosticStatus, "~/status", LATCHED)
        self._state = "waiting for subscribers"
        self._player = self._make_player()
        self._ending = threading.Event()
        self._offer_services()
        self.create_timer(STATUS_PERIOD, self._publish_status, clock=self.steady_clock)
        sys.setswitchinterval(SWITCH_INTERVAL)
        self._thread = threading.Thread(target=self._play, name="player", daemon=True)
        self._thread.start()

    def _open(self) -> BagReader:
        if not self.config.uri:
            raise InvalidValueError("uri", "", "the folder of a bag or an MCAP file")
        limits = BagLimits(self.config.max_compression_ratio, self.config.max_unpacked_size)
        reader = BagReader(Path(self.config.uri), limits)
        if reader.warning:
            self.get_logger().warning(reader.warning)
        return reader

    def _selected_topics(self) -> dict[str, Topic]:
        config, namespace = self.config, self.get_namespace()
        selection = TopicSelection(
            topics=tuple(absolute(name, namespace) for name in config.topics),
            regex=config.regex,
            exclude_topics=tuple(absolute(name, namespace) for name in config.exclude_topics),
            exclude_regex=config.exclude_regex,
            include_hidden_topics=True,
        )
        selection.check()
        known = self._reader.topics
        for name in selection.topics:
            if name not in known:
                self.get_logger().warning(f"{name} is not in the bag")
        selected = {name: topic for name, topic in known.items() if selection.selects(name)}
        if config.clock > 0.0:
            # Two publishers of /clock would make time jump back and forth.
            selected.pop(CLOCK_TOPIC, None)
        if not any(topic.message_count for topic in selected.values()):
            raise DiffbotError(f"{self._reader.path} has no message to play")
        return selected

    def _make_window(self) -> Window:
        config = self.config
        if config.clock > 0.0 and self._reader.end >= MAX_CLOCK:
            raise DiffbotError(f"{self._reader.path} ends at {self._reader.end} ns, which /clock cannot hold")
        return window(
            self._reader.start,
            self._reader.end,
            config.start_offset,
            config.playback_duration,
            config.playback_until,
        )

    def _make_publishers(self) -> dict[str, Any]:
        names = parse_remap(self.config.remap)
        publishers = {}
        for name, topic in self._topics.items():
            try:
                publishers[name] = self.create_publisher(
                    ros_conversions.message_class(topic.type),
                    names.get(name, name),
                    ros_conversions.to_ros(to_offer(topic.qos)),
                )
            except (DiffbotError, InvalidTopicNameException) as error:
                self.get_logger().warning(f"{shown(name)} is not played: {shown(' '.join(str(error).split()))}")
        if not publishers:
            raise DiffbotError(f"no topic of {self._reader.path} can be published")
        return publishers

    def _make_player(self) -> Player:
        config = self.config
        return Player(
            self._window,
            self._messages,
            self._send,
            Pace(
                rate=config.rate,
                loop=config.loop,
                delay=config.delay,
                start_paused=config.start_paused,
                clock=config.clock,
                read_ahead=config.read_ahead_queue_size,
            ),
            self._send_clock,
        )

    def _messages(self) -> Iterator[RawMessage]:
        return self._reader.messages(self._outputs, self._window.start, self._window.end)

    def _play(self) -> None:
        exit_code = 1
        try:
            self._wait_for_subscribers()
            self._send_latched()
            self._state = "playing"
            began = time.perf_counter()
            self._player.play()
            self._log_end(time.perf_counter() - began)
            self._wait_until_acknowledged()
            self._state = "stopped" if self._ending.is_set() else "done"
            exit_code = 0
        except DiffbotError as error:
            self._state = "read error"
            self.get_logger().error(str(error))
        finally:
            self.finish(exit_code)

    def _wait_for_subscribers(self) -> None:
        config = self.config
        named = {absolute(name, self.get_namespace()) for name in config.wait_for_topics}
        if unknown := named - set(self._outputs):
            self.get_logger().warning(f"wait_for_topics that are not played are ignored: {' '.join(sorted(unknown))}")
        required = (named & set(self._outputs)) or set(self._outputs)
        missing = wait_for_subscribers(self._outputs, required, config.wait_timeout, self._ending)
        if missing and named:
            self.get_logger().warning(f"no subscriber after {config.wait_timeout:g} s: {' '.join(sorted(missing))}")

    def _send_latched(self) -> None:
        """Send, for each transient local topic, the last message before the start of the window."""
        latched = {
            name for name in self._outputs if any(qos.durability == "transient_local" for qos in self._topics[name].qos)
        }
        for message in self._reader.last_before(self._window.start, latched):
            self._send(message)

    def _send(self, message: RawMessage) -> None:
        self._outputs[message.topic].publish(message.data)
        self.health.sent[message.topic] += 1

    def _send_clock(self, bag_time: int) -> None:
        message = Clock()
        message.clock.sec, message.clock.nanosec = divmod(bag_time, SECOND)
        if self._clock_publisher is not None:
            self._clock_publisher.publish(message)

    def _wait_until_acknowledged(self) -> None:
        timeout = self.config.wait_acked_timeout
        self._ending.wait(SETTLE)
        missing = wait_until_acknowledged(self._outputs, timeout, Duration(seconds=POLL), self._ending)
        if missing and not self._ending.is_set():
            self.get_logger().warning(f"not acknowledged after {timeout:g} s: {' '.join(sorted(missing))}")

    def _log_end(self, took: float) -> None:
        late = sorted(self._player.lateness)
        text = f"{self._player.progress().sent} messages in {took:.3f} s"
        if late:
            median, high = late[len(late) // 2], late[min(len(late) - 1, len(late) * 99 // 100)]
            text += f"; late: median {median / 1e3:.1f} us, 99 % within {high / 1e6:.2f} ms"
        self.get_logger().info(text)

    def _offer_services(self) -> None:
        def pause() -> tuple[bool, str]:
            self._player.pause()
            return True, "paused"

        def resume() -> tuple[bool, str]:
            self._player.resume()
            return True, "playing"

        def toggle() -> tuple[bool, str]:
            return True, "paused" if self._player.toggle_paused() else "playing"

        def is_paused() -> tuple[bool, str]:
            return True, "paused" if self._player.progress().is_paused else "playing"

        def stop() -> tuple[bool, str]:
            self._end()
            return True, "stopped"

        def play_next() -> tuple[bool, str]:
            sent = self._player.play_next()
            return sent, "one message sent" if sent else "not paused, or no message left"

        for name, action in (
            ("pause", pause),
            ("resume", resume),
            ("toggle_paused", toggle),
            ("is_paused", is_paused),
            ("stop", stop),
            ("play_next", play_next),
        ):
            self.create_service(Trigger, f"~/{name}", self._answering(action))

    def _answering(self, action: Callable[[], tuple[bool, str]]) -> Callable[[Any, Any], Any]:
        def answer(_request: Any, response: Any) -> Any:
            response.success, response.message = action()
            self._publish_status()
            return response

        return answer

    def _end(self) -> None:
        self._ending.set()
        self._player.stop()

    def _publish_status(self) -> None:
        progress = self._player.progress()
        start, end = self._window
        state = self._state
        if state == "playing" and progress.is_paused:
            state = "paused"
        played = (progress.bag_time - start) / (end - start) if end > start else 1.0
        values = {
            "uri": str(self._reader.path.absolute()),
            "time": f"{progress.bag_time / SECOND:.3f}",
            "progress": f"{max(0.0, played):.3f}",
            "messages": str(progress.sent),
            "rounds": str(progress.rounds),
            "rate": f"{self.config.rate:g}",
        }
        level = DiagnosticStatus.ERROR if state == "read error" else DiagnosticStatus.OK
        self._status.publish(status_message(self.get_fully_qualified_name(), level[0], state, values))

    def before_shutdown(self) -> None:
        """Stop the player and close the bag."""
        self._end()
        self._thread.join()
        self._publish_status()
        self._reader.close()


def main(args: list[str] | None = None) -> int:
    """Play a bag; return the exit status."""
    return run(ReplayNode, args)
