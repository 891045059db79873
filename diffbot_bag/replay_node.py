"""The node ``replay``: publishes the messages of bags at the recorded times with the recorded QoS."""

from __future__ import annotations

import datetime
import sys
import threading
import time
import traceback
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rcl_interfaces.msg import SetParametersResult
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock
from std_srvs.srv import Trigger

from diffbot_bag.bag import MergedBags, RawMessage
from diffbot_bag.keyboard import RIGHT, SPACE, UP, Keyboard
from diffbot_bag.metadata import Topic
from diffbot_bag.parameters import MAX_RATE, MIN_RATE, ReplayConfig
from diffbot_bag.player import Player, Sink, Source, duration_text, nanoseconds, window
from diffbot_bag.publications import CLOCK_TOPIC, Publications
from diffbot_bag.qos import read_overrides
from diffbot_bag.topic_selection import selection_of
from diffbot_core.errors import DiffbotError, InvalidValueError
from diffbot_core.ros.node import DiffbotNode, status_message
from diffbot_core.ros.qos import LATCHED, QUEUE
from diffbot_core.ros.run import run
from diffbot_core.stamps import NS_PER_S

READ_ERROR, ERROR = "read error", "error"
"""States in ~/status after a damaged bag, and after an unexpected exception of the player."""
STATUS_PERIOD = 0.5
"""[s] time between two ~/status messages"""
KEY_PERIOD = 0.05
"""[s] time between two checks of the keyboard"""
RATE_STEP = 0.1
"""[-] relative change of the rate by the arrow keys"""
ACKNOWLEDGEMENT_TIMEOUT = 5.0
"""[s] longest wait for reliable subscribers at the end of the replay"""
MAX_CLOCK = 2**31 * NS_PER_S
"""[ns] smallest time that is too large for builtin_interfaces/Time"""
SWITCH_INTERVAL = 0.0005
"""[s] time after which Python switches threads; with its default of 5 ms, reading ahead delays messages"""
PLAYER_NAME = "rosbag2_player"
"""Name of rosbag2's node, which its clients use for the names of services."""


class ReplayNode(DiffbotNode[ReplayConfig]):
    """Publishes the messages of one bag, or of several bags merged by log time, and then ends the process."""

    qos_by_parameters = False

    def __init__(self, **node_options: Any) -> None:
        """Open the bags, create a publisher for each topic and start to play.

        Raises:
            DiffbotError: if a parameter is not allowed or a bag cannot be read.
        """
        super().__init__("replay", ReplayConfig, **node_options)
        config = self.config
        with ExitStack() as on_error:
            on_error.callback(self.destroy_node)
            if not config.uri:
                raise InvalidValueError("uri", "", "the folder of a bag or an MCAP file")
            self._bags = bags = MergedBags([Path(path) for path in (config.uri, *config.bags)])
            on_error.callback(bags.close)
            for warning in bags.warnings:
                self.get_logger().warning(warning)
            topics = self._selected_topics()
            if config.clock > 0.0 and bags.end >= MAX_CLOCK:
                raise DiffbotError(
                    f"{bags} ends at {bags.end} ns, which /clock cannot hold: set the parameter clock to 0"
                )
            self._window = window(bags.start, bags.end, config.start_offset, config.playback_duration)
            overrides = read_overrides(config.qos_profile_overrides_path, self.get_namespace())
            self._publications = Publications(self, topics, overrides, bounded=config.as_fast_as_possible)
            if not self._publications.names:
                raise DiffbotError(f"no topic of {bags} can be published")
            self._player = self._make_player()
            if config.seek >= 0.0:
                self._player.seek(self._time_of(config.seek))
            on_error.pop_all()
        self._state = "waiting for subscribers"
        self._status = self.create_publisher(DiagnosticStatus, "~/status", LATCHED)
        self._keyboard = self._open_keyboard()
        self._offer_services()
        self.add_on_set_parameters_callback(self._check)
        self.add_post_set_parameters_callback(self._apply)
        self.create_timer(STATUS_PERIOD, self._publish_status, clock=self.steady_clock)
        sys.setswitchinterval(SWITCH_INTERVAL)
        self._thread = threading.Thread(target=self._play, name="player", daemon=True)
        self._thread.start()

    def _selected_topics(self) -> dict[str, Topic]:
        config, known = self.config, self._bags.topics
        selection = selection_of(config, self.get_namespace(), include_hidden_topics=True)
        for name in selection.topics:
            if name not in known:
                self.get_logger().warning(f"{name} is not in the bag")
        selected = {name: topic for name, topic in known.items() if selection.selects(name)}
        if config.clock > 0.0:
            # With two publishers of /clock, time would jump back and forth.
            selected.pop(CLOCK_TOPIC, None)
        if not any(topic.message_count for topic in selected.values()):
            raise DiffbotError(f"{self._bags} does not contain messages of the selected topics")
        return selected

    def _make_player(self) -> Player:
        config, bags, publications = self.config, self._bags, self._publications
        source = Source(
            lambda start: bags.messages(publications.names, start, self._window.end),
            lambda start: bags.latched_before(start, publications.latched),
        )
        clock = self._make_clock() if config.clock > 0.0 else lambda _: None
        return Player(self._window, source, Sink(self._send, clock, self._report_gap), config)

    def _make_clock(self) -> Callable[[int], None]:
        publisher = self.create_publisher(Clock, CLOCK_TOPIC, QUEUE)

        def send(bag_time: int) -> None:
            message = Clock()
            message.clock.sec, message.clock.nanosec = divmod(bag_time, NS_PER_S)
            publisher.publish(message)

        return send

    def _send(self, message: RawMessage) -> None:
        self._publications.send(message)
        self.health.sent[message.topic] += 1

    def _report_gap(self, start: int, end: int) -> None:
        position, name = (start - self._bags.start) / NS_PER_S, self.get_fully_qualified_name()
        self.get_logger().warning(
            f"gap of {duration_text(end - start)} without messages at {position:.3f} s of the bag, from {utc(start)}"
            f" to {utc(end)}: to skip it, call `ros2 param set {name} skip_gaps true`, or start with skip_gaps"
        )

    def _play(self) -> None:
        exit_code = 1
        try:
            self._publications.wait_for_subscribers(self.config.wait_timeout)
            self._state = "playing"
            began = time.perf_counter()
            self._player.play()
            self._log_end(time.perf_counter() - began)
            missing = self._publications.wait_until_acknowledged(ACKNOWLEDGEMENT_TIMEOUT)
            if missing and not self._publications.stop.is_set():
                names = " ".join(sorted(missing))
                self.get_logger().warning(
                    f"some subscribers have not acknowledged all messages after {ACKNOWLEDGEMENT_TIMEOUT:g} s: {names}"
                )
            self._state = "stopped" if self._publications.stop.is_set() else "done"
            exit_code = 0
        except DiffbotError as error:
            self._state = READ_ERROR
            self.get_logger().error(str(error))
        except Exception as error:  # the status must not stay "playing"
            self._state = ERROR
            self.get_logger().error("".join(traceback.format_exception(error)))
        finally:
            self.finish(exit_code)

    def _log_end(self, duration: float) -> None:
        lateness = sorted(self._player.lateness)
        text = f"{self._player.progress().sent} messages in {duration:.3f} s"
        if lateness:
            median, p99 = (lateness[len(lateness) * percent // 100] for percent in (50, 99))
            text += f"; lateness: median {median / 1e3:.1f} us, 99 % within {p99 / 1e6:.2f} ms"
        self.get_logger().info(text)

    def _publish_status(self) -> None:
        progress = self._player.progress()
        start, end = self._window
        state = "paused" if self._state == "playing" and progress.is_paused else self._state
        played = (progress.bag_time - start) / (end - start) if end > start else 1.0
        values = {
            "uri": " ".join(str(path.absolute()) for path in self._bags.paths),
            "time": f"{progress.bag_time / NS_PER_S:.3f}",
            "progress": f"{max(0.0, played):.3f}",
            "messages": str(progress.sent),
            "rounds": str(progress.rounds),
            "rate": f"{progress.rate:g}" if progress.rate else "as fast as possible",
        }
        level = DiagnosticStatus.ERROR if state in (READ_ERROR, ERROR) else DiagnosticStatus.OK
        self._status.publish(status_message(self.get_fully_qualified_name(), level[0], state, values))

    def _end(self) -> None:
        self._publications.stop.set()
        self._player.stop()

    def _time_of(self, seek: float) -> int:
        """Return the log time [ns] for a value [s] of the parameter ``seek``."""
        log_time, origin = self._bags.start + nanoseconds(seek), self._bags.start
        if not self._window.start <= log_time <= self._window.end:
            low, high = ((bound - origin) / NS_PER_S for bound in self._window)
            raise InvalidValueError("seek", seek, f">= {low:.9g} s and <= {high:.9g} s, the part that is played")
        return log_time

    def _check(self, changes: list[Any]) -> SetParametersResult:
        values, config = {change.name: change.value for change in changes}, self.config
        try:
            if values.get("seek", -1.0) >= 0.0:
                self._time_of(values["seek"])
            if config.as_fast_as_possible and values.get("rate", config.rate) != config.rate:
                sentence = "the rate cannot be changed with as_fast_as_possible"
                raise InvalidValueError("rate", values["rate"], sentence=sentence)
        except DiffbotError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _apply(self, changes: list[Any]) -> None:
        # rclpy calls the newest callback first, so self.config may still have the old values of these parameters.
        for change in changes:
            if change.name == "rate" and not self.config.as_fast_as_possible:
                self._player.set_rate(change.value)
            elif change.name == "seek" and change.value >= 0.0:
                self._player.seek(self._time_of(change.value))
            elif change.name == "skip_gaps":
                self._player.set_skip_gaps(change.value)

    def _set_rate(self, rate: float) -> bool:
        """Change the parameter ``rate``; return False if the value is not allowed."""
        return bool(self.set_parameters([Parameter("rate", value=float(rate))])[0].successful)

    def _open_keyboard(self) -> Keyboard | None:
        if self.config.disable_keyboard_controls or not (keyboard := Keyboard()).is_open:
            return None
        self.get_logger().info(
            "keys: space pauses and resumes, right sends the next message while paused, up and down change the rate"
        )
        self.create_timer(KEY_PERIOD, lambda: self._on_keys(keyboard.pressed()), clock=self.steady_clock)
        return keyboard

    def _on_keys(self, keys: list[str]) -> None:
        for key in keys:
            if key == SPACE:
                self._pause(not self._is_paused())
                self.get_logger().info("paused" if self._is_paused() else "playing")
            elif key == RIGHT:
                self._player.step(timeout=0.0)
            elif not self.config.as_fast_as_possible:
                rate = self.config.rate * (1.0 + (RATE_STEP if key == UP else -RATE_STEP))
                self._set_rate(min(max(rate, MIN_RATE), MAX_RATE))
                self.get_logger().info(f"rate {self.config.rate:.3g}")

    def _pause(self, paused: bool) -> dict[str, Any]:
        self._player.pause(paused)
        return {}

    def _is_paused(self) -> bool:
        return self._player.progress().is_paused

    def _offer_services(self) -> None:
        """Offer Triggers below the node's name and, if rosbag2_interfaces is installed, the services of rosbag2.

        A Trigger does not have arguments, so seek and set_rate are parameters instead.
        """
        for name, action in self._actions().items():
            if name not in ("seek", "set_rate"):
                self.create_service(Trigger, f"~/{name}", self._service_callback(action, self._to_trigger))
        try:
            from rosbag2_interfaces import srv  # noqa: PLC0415 - not available as a wheel
        except ImportError:
            return
        self.offer_rosbag2_services(srv)

    def offer_rosbag2_services(self, types: Any) -> None:
        """Offer the services of rosbag2's player; ``types`` is the module rosbag2_interfaces.srv."""
        for name, action in self._actions().items():
            kind = getattr(types, "".join(word.capitalize() for word in name.split("_")))
            self.create_service(kind, f"{PLAYER_NAME}/{name}", self._service_callback(action, lambda fields: fields))

    def _actions(self) -> dict[str, Callable[[Any], dict[str, Any]]]:
        """Return the functions of the services. Each returns the fields of rosbag2's response to a request."""
        player = self._player

        def seek(request: Any) -> dict[str, Any]:
            log_time = int(request.time.sec) * NS_PER_S + int(request.time.nanosec)
            return {"success": self._window.start <= log_time <= self._window.end and player.seek(log_time)}

        def stop(_request: Any) -> dict[str, Any]:
            self._end()
            return {}

        return {
            "pause": lambda _: self._pause(True),
            "resume": lambda _: self._pause(False),
            "toggle_paused": lambda _: self._pause(not self._is_paused()),
            "stop": stop,
            "is_paused": lambda _: {"paused": self._is_paused()},
            "get_rate": lambda _: {"rate": player.progress().rate},
            "play_next": lambda _: {"success": player.step()},
            "set_rate": lambda request: {"success": self._set_rate(request.rate)},
            "seek": seek,
        }

    def _to_trigger(self, fields: dict[str, Any]) -> dict[str, Any]:
        """Return the fields of a Trigger's response, with the rate or the state of the player as message."""
        state = "stopped" if self._publications.stop.is_set() else "paused" if self._is_paused() else "playing"
        text = f"{fields['rate']:g}" if "rate" in fields else state
        return {"success": fields.get("success", True), "message": text}

    def _service_callback(
        self, action: Callable[[Any], dict[str, Any]], to_response: Callable[[dict[str, Any]], dict[str, Any]]
    ) -> Callable[[Any, Any], Any]:
        def respond(request: Any, response: Any) -> Any:
            for field, value in to_response(action(request)).items():
                setattr(response, field, value)
            self._publish_status()
            return response

        return respond

    def before_shutdown(self) -> None:
        """Stop the player, restore the terminal and close the bags."""
        self._end()
        self._thread.join()
        if self._keyboard is not None:
            self._keyboard.close()
        self._publish_status()
        self._bags.close()


def utc(log_time: int) -> str:
    """Return a log time [ns] as text, with date and time in UTC."""
    moment = datetime.datetime.fromtimestamp(log_time // NS_PER_S, datetime.timezone.utc)
    return moment.strftime("%Y-%m-%d %H:%M:%S UTC")


def main(args: list[str] | None = None) -> int:
    """Play a bag; return the exit status."""
    return run(ReplayNode, args)


if __name__ == "__main__":
    raise SystemExit(main())
