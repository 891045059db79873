"""The node ``watch``: passes messages of robots to the server of the page, and requests of browsers to the robots."""

from __future__ import annotations

import html
import os
import sys
import tempfile
import threading
import time
import webbrowser
from functools import partial
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

from diffbot_control.law.registry import PRESETS, TUNED
from diffbot_core.errors import DiffbotError
from diffbot_core.files import runtime_folder
from diffbot_core.ros.node import DiffbotNode
from diffbot_core.ros.qos import QUEUE
from diffbot_core.ros.run import run
from diffbot_tools.view.constants import constants_of
from diffbot_tools.view.live_state import LiveState
from diffbot_tools.view.requests import Request
from diffbot_tools.view.server import Address, PageServer, Reply
from diffbot_tools.view.texts import BoundedTable, Status, statuses_of
from diffbot_tools.view.track import PageClock
from diffbot_tools.watch.parameters import WatchConfig, robot_names
from diffbot_tools.watch.recording import PageRecording
from diffbot_tools.watch.robot_client import RobotClient, RobotInfo
from diffbot_tools.watch.ros_source import RobotSource

_UPDATE_PERIOD = 1.0
_OUTDATED = 5.0
"""[s] After this time, the last diagnosis of a node is stale; a node sends one each second."""
_STALE, _ENDED = 3, 4
"""Levels of a stale diagnosis, and of the diagnosis of a node that has left the graph."""
MAX_NODES = 100
"""Number of nodes whose diagnoses are shown."""


class WatchNode(DiffbotNode[WatchConfig]):
    """Subscribes to the robots. One thread serves the browsers, and one thread per robot handles requests."""

    def __init__(self, **node_options: Any) -> None:
        """Start the server and subscribe."""
        super().__init__("watch", WatchConfig, **node_options)
        config = self.config
        self._names = robot_names(config.namespaces)
        self._state = LiveState(self._names)
        self._diagnoses: BoundedTable[str, tuple[float, Status]] = BoundedTable(MAX_NODES)
        on_error = partial(self.contain, where="the server of the page")
        address = Address(config.host, config.port)
        constants = constants_of(PRESETS[TUNED].config)
        self.server = PageServer(self._state, constants, self._on_request, on_error, address)
        try:
            self.server.start()
        except DiffbotError:
            self.destroy_node()
            raise
        folder = config.record_folder
        self._info: dict[str, RobotInfo] = {}
        self._present: set[str] = set()
        """names of all nodes in the graph"""
        self._recording = PageRecording(Path(folder), self._put_recording) if folder else None
        clock = PageClock()
        self._robots: dict[str, RobotSource] = {}
        self._robot_clients: dict[str, RobotClient] = {}
        for name, namespace in zip(self._names, config.namespaces, strict=True):
            self._robots[name] = RobotSource(self, name, namespace, self._state, clock)
            self._robot_clients[name] = RobotClient(namespace, config, self.context, partial(self._on_info, name))
        self.subscribe(DiagnosticArray, "/diagnostics", self._on_diagnostics, QUEUE)
        self.create_timer(_UPDATE_PERIOD, self._update, clock=self.steady_clock)
        self._put_recording()
        print(f"Page: {self.server.url}", flush=True)
        self._opened = _open_page(self.server.url) if config.open_browser else None

    def _on_request(self, request: Request, reply: Reply) -> None:
        """Pass a request to the robot or to the recorder; called in the server's thread."""
        if request.kind != "record":
            self._robot_clients[request.robot].add(request, reply)
        elif self._recording is not None:
            self._recording.add(request.is_on, reply)
        else:
            reply("recording is off: start diffbot watch with --record FOLDER", 2)

    def _on_info(self, name: str, info: RobotInfo) -> None:
        """Store the services and parameters of a robot; called in the thread of its client."""
        self._state.put(name, "services", info.services)
        if info.constants is not None:
            self._state.put(name, "constants", info.constants)
        self._info[name] = info

    def _put_recording(self) -> None:
        is_on = self._recording is not None and self._recording.is_on
        self._state.put("", "record", {"isThere": self._recording is not None, "isOn": is_on})

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        statuses = statuses_of(message)
        for status in statuses:
            self._diagnoses[status.name] = time.monotonic(), status
        for robot in self._robots.values():
            robot.model.add("diagnostics", message)
        self._put_diagnoses()

    def _put_diagnoses(self) -> None:
        now = time.monotonic()

        def level(received: float, status: Status) -> int:
            if now - received <= _OUTDATED:
                return status.level
            return _STALE if status.name.partition(":")[0] in self._present else _ENDED

        shown = [
            {"name": one.name, "level": level(received, one), "message": one.message}
            for _, (received, one) in sorted(self._diagnoses.items())
        ]
        self._state.put("", "diagnostics", shown)

    def _update(self) -> None:
        # Only the thread of the executor changes the models.
        for name, info in list(self._info.items()):
            model = self._robots[name].model
            model.set_state(is_paused=info.services["pause"]["isOn"])
            model.docking_config = info.docking or model.docking_config
            if info.constants is not None:
                model.tolerance = info.constants["xy_tolerance"]
        types = dict(self.get_topic_names_and_types())
        self._present = {f"{space.rstrip('/')}/{name}" for name, space in self.get_node_names_and_namespaces()}
        for robot in self._robots.values():
            robot.update(types)
        if self._diagnoses:
            self._put_diagnoses()
        self._put_recording()

    def health_level(self) -> tuple[int, str]:
        """Return level and message for /diagnostics, which the page shows, too."""
        found = [super().health_level()]
        if self._recording is not None and self._recording.problem:
            found.append((DiagnosticStatus.ERROR[0], self._recording.problem))
        if self._diagnoses.dropped:
            text = f"{self._diagnoses.dropped} names dropped: the page shows the diagnoses of {MAX_NODES} nodes"
            found.append((DiagnosticStatus.WARN[0], text))
        return max(found, key=lambda one: one[0])

    def before_shutdown(self) -> None:
        """Close the page, the clients of the robots and a recording."""
        if self._opened is not None:
            self._opened.unlink(missing_ok=True)
        self.server.stop()
        for client in self._robot_clients.values():
            client.stop()
        if self._recording is not None:
            self._recording.close()


def _open_page(url: str) -> Path | None:
    """Open the page in a browser by a file that redirects to the page; return the file, None without a browser.

    Only this user can read the file. Every user of the machine could read the token on the browser's command line.
    """
    if not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        return None  # without a screen, webbrowser could start a text browser in the terminal
    try:
        number, name = tempfile.mkstemp(".html", "page_", runtime_folder())  # readable for this user only
        with open(number, "w", encoding="utf-8") as file:
            file.write(f'<!doctype html>\n<meta http-equiv="refresh" content="0; url={html.escape(url)}">\n')
    except OSError as error:
        print(f"The browser was not started: {error}. Open the address above.", file=sys.stderr)
        return None
    path = Path(name)
    threading.Thread(target=webbrowser.open, args=(path.as_uri(),), daemon=True).start()
    return path


def main(args: list[str] | None = None) -> int:
    """Run the node; return the exit status of the process."""
    return run(WatchNode, args)


if __name__ == "__main__":
    raise SystemExit(main())
