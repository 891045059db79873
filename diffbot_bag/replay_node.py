"""The node ``replay``: publishes the messages of bags with the recorded QoS at the recorded times."""

from __future__ import annotations

if __name__ == "__main__":  # before the imports that take long: see launcher
    from diffbot_core.launcher import launch

    raise SystemExit(launch("diffbot_bag.replay_node"))

import math
import sys
import threading
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus

from diffbot_bag.bag.merged_bags import MergedBags
from diffbot_bag.bag.metadata import Topic
from diffbot_bag.bag.qos import REPLAY_DEPTH
from diffbot_bag.bag.qos_overrides import read_overrides
from diffbot_bag.bag.reader import RawMessage
from diffbot_bag.bag.topic_selection import TopicSelection, absolute
from diffbot_bag.mcap.chunks import BagLimits
from diffbot_bag.parameters import ReplayConfig
from diffbot_bag.replay.playback_clock import SECOND, Window, parse_remap, window
from diffbot_bag.replay.player import Pace, Player, Sink, Source
from diffbot_bag.ros.replay_control import ReplayControl
from diffbot_bag.ros.replay_outputs import CLOCK_TOPIC, Naming, ReplayOutputs, clock_sender
from diffbot_bag.ros.replay_services import ReplayServices
from diffbot_core.errors import DiffbotError, InvalidValueError
from diffbot_core.ros.node import LATCHED, DiffbotNode, run, status_message

STATUS_PERIOD = 0.5
"""[s] between two ~/status messages."""
MAX_CLOCK = 2**31 * SECOND
"""[ns] times that do not fit into builtin_interfaces/Time"""
SWITCH_INTERVAL = 0.0005
"""[s] after which Python switches threads; with the default of 5 ms, reading ahead would delay messages"""


class ReplayNode(DiffbotNode[ReplayConfig]):
    """Publishes the messages of one bag, or of several merged by time, then exits."""

    qos_by_parameters = False

    def __init__(self, **node_options: Any) -> None:
        """Open the bags, create a publisher per topic and start to play.

        Raises:
            DiffbotError: if a parameter is not allowed or a bag cannot be read.
        """
        super().__init__("replay", ReplayConfig, **node_options)
        self._ending = threading.Event()
        with ExitStack() as refused:
            refused.callback(self.destroy_node)
            self._bags = self._open()
            refused.callback(self._bags.close)
            topics = self._selected_topics()
            self._window = self._make_window()
            self._outputs = self._make_outputs(topics)
            self._player = self._make_player()
            self._control = ReplayControl(self, self._player, self._bags.start, self._window, self._ending)
            refused.pop_all()
        self._status = self.create_publisher(DiagnosticStatus, "~/status", LATCHED)
        self._state = "waiting for subscribers"
        self._offers = ReplayServices(self, self._player, self._control, self._publish_status)
        self.create_timer(STATUS_PERIOD, self._publish_status, clock=self.steady_clock)
        if not self.config.disable_keyboard_controls:
            self._control.use_keyboard()
        sys.setswitchinterval(SWITCH_INTERVAL)
        self._thread = threading.Thread(target=self._play, name="player", daemon=True)
        self._thread.start()

    def _open(self) -> MergedBags:
        config = self.config
        if not config.uri:
            raise InvalidValueError("uri", "", "the folder of a bag or an MCAP file")
        limits = BagLimits(config.max_compression_ratio, config.max_unpacked_size)
        bags = MergedBags([Path(path) for path in (config.uri, *config.bags)], limits)
        for warning in bags.warnings:
            self.get_logger().warning(warning)
        return bags

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
        known = self._bags.topics
        for name in selection.topics:
            if name not in known:
                self.get_logger().warning(f"{name} is not in the bag")
        selected = {name: topic for name, topic in known.items() if selection.selects(name)}
        if config.clock > 0.0:
            # Two publishers of /clock would make time jump back and forth.
            selected.pop(CLOCK_TOPIC, None)
        if not any(topic.message_count for topic in selected.values()):
            raise DiffbotError(f"{self._bags} has no message to play")
        return selected

    def _make_window(self) -> Window:
        config, bags = self.config, self._bags
        if config.clock > 0.0 and bags.end >= MAX_CLOCK:
            raise DiffbotError(f"{bags} ends at {bags.end} ns, which /clock cannot hold")
        return window(bags.start, bags.end, config.start_offset, config.playback_duration, config.playback_until)

    def _make_outputs(self, topics: dict[str, Topic]) -> ReplayOutputs:
        config = self.config
        naming = Naming(
            remap=parse_remap(config.remap),
            overrides=read_overrides(config.qos_profile_overrides_path, REPLAY_DEPTH, self.get_namespace()),
            max_unacknowledged=config.max_unacknowledged if config.as_fast_as_possible else 0,
            patience=math.inf if config.as_fast_as_possible else config.wait_acked_timeout or math.inf,
        )
        outputs = ReplayOutputs(self, topics, naming, self._ending)
        if not outputs.names:
            raise DiffbotError(f"no topic of {self._bags} can be published")
        return outputs

    def _make_player(self) -> Player:
        config, bags, outputs = self.config, self._bags, self._outputs
        pace = Pace(
            rate=0.0 if config.as_fast_as_possible else config.rate,
            loop=config.loop,
            delay=config.delay,
            start_paused=config.start_paused,
            clock=config.clock,
            read_ahead=config.read_ahead_queue_size,
        )
        source = Source(
            lambda start: bags.messages(outputs.names, start, self._window.end),
            lambda start: bags.last_before(start, outputs.latched),
        )
        return Player(self._window, source, Sink(self._send, clock_sender(self) if config.clock > 0.0 else None), pace)

    def _send(self, message: RawMessage) -> None:
        self._outputs.send(message)
        self.health.sent[message.topic] += 1

    def _play(self) -> None:
        exit_code = 1
        try:
            self._wait_for_subscribers()
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
        config, names = self.config, set(self._outputs.names)
        named = {absolute(name, self.get_namespace()) for name in config.wait_for_topics}
        if unknown := named - names:
            self.get_logger().warning(f"wait_for_topics that are not played are ignored: {' '.join(sorted(unknown))}")
        missing = self._outputs.wait_for_subscribers(named & names, config.wait_timeout)
        if missing and named:
            self.get_logger().warning(f"no subscriber after {config.wait_timeout:g} s: {' '.join(sorted(missing))}")

    def _wait_until_acknowledged(self) -> None:
        timeout = self.config.wait_acked_timeout
        missing = self._outputs.wait_until_acknowledged(timeout)
        if missing and not self._ending.is_set():
            self.get_logger().warning(f"not acknowledged after {timeout:g} s: {' '.join(sorted(missing))}")

    def _log_end(self, took: float) -> None:
        late = sorted(self._player.lateness)
        text = f"{self._player.progress().sent} messages in {took:.3f} s"
        if late:
            median, high = late[len(late) // 2], late[min(len(late) - 1, len(late) * 99 // 100)]
            text += f"; late: median {median / 1e3:.1f} us, 99 % within {high / 1e6:.2f} ms"
        self.get_logger().info(text)

    def _publish_status(self) -> None:
        progress = self._player.progress()
        start, end = self._window
        state = self._state
        if state == "playing" and progress.is_paused:
            state = "paused"
        played = (progress.bag_time - start) / (end - start) if end > start else 1.0
        values = {
            "uri": " ".join(str(path.absolute()) for path in self._bags.paths),
            "time": f"{progress.bag_time / SECOND:.3f}",
            "progress": f"{max(0.0, played):.3f}",
            "messages": str(progress.sent),
            "rounds": str(progress.rounds),
            "rate": f"{progress.rate:g}" if progress.rate else "as fast as possible",
        }
        level = DiagnosticStatus.ERROR if state == "read error" else DiagnosticStatus.OK
        self._status.publish(status_message(self.get_fully_qualified_name(), level[0], state, values))

    def before_shutdown(self) -> None:
        """Stop the player, restore the terminal and close the bags."""
        self._control.end()
        self._thread.join()
        self._control.close()
        self._publish_status()
        self._bags.close()


def main(args: list[str] | None = None) -> int:
    """Play a bag; return the exit status."""
    return run(ReplayNode, args)
