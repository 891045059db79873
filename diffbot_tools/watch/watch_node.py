"""The node ``watch``: hands the topics of robots to a page server, and requests of browsers to the robots."""

from __future__ import annotations

if __name__ == "__main__":  # before the imports that take long: see launcher
    from diffbot_core.launcher import launch

    raise SystemExit(launch("diffbot_tools.watch.watch_node"))

import time
from functools import partial
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

from diffbot_control.law.presets import PRESETS, TUNED
from diffbot_core.cdr import CdrError
from diffbot_core.errors import BadMessageError, DiffbotError
from diffbot_core.ros.node import QUEUE, DiffbotNode, run
from diffbot_tools.view.bounded_table import BoundedTable
from diffbot_tools.view.constants import constants_of
from diffbot_tools.view.intake import Request
from diffbot_tools.view.live_state import LiveState
from diffbot_tools.view.server import Address, PageServer, Reply
from diffbot_tools.view.texts import Status, read_statuses
from diffbot_tools.watch.opened_page import OpenedPage
from diffbot_tools.watch.parameters import WatchConfig, robot_names
from diffbot_tools.watch.recording import Recording
from diffbot_tools.watch.ros.errands import Errands, Found
from diffbot_tools.watch.ros.robot_watch import RobotWatch, SharedClock

_LOOK_PERIOD = 1.0
_OUTDATED, _STALE, _ENDED = 5.0, 3, 4
"""[s] without a new diagnosis, due once a second, after which the last one is shown as stale; the level STALE, and
that of a node that has left the graph"""
MAX_NODES = 100
"""whose diagnoses are shown"""


class WatchNode(DiffbotNode[WatchConfig]):
    """Subscribes for the page; browsers are served in a thread, requests done in one per robot."""

    def __init__(self, **node_options: Any) -> None:
        """Start the server and subscribe."""
        super().__init__("watch", WatchConfig, **node_options)
        config = self.config
        self._names = robot_names(config.namespaces)
        self._state = LiveState(self._names)
        self._constants = constants_of(PRESETS[TUNED])
        self._diagnoses: BoundedTable[str, tuple[float, Status]] = BoundedTable(MAX_NODES)
        self._found_services: dict[str, dict[str, bool]] = {}
        on_error = partial(self.contain, where="the server of the page")
        address = Address(config.host, config.port)
        self.server = PageServer(self._state, self._constants, self._on_request, on_error, address)
        try:
            self.server.start()
        except DiffbotError:
            self.destroy_node()
            raise
        folder = config.record_folder
        self._present: set[str] = set()
        """names of the nodes in the graph"""
        self._recording = Recording(Path(folder), self._put_services) if folder else None
        clock = SharedClock()
        robots = zip(self._names, config.namespaces, strict=True)
        self._robots = {name: RobotWatch(self, name, namespace, self._state, clock) for name, namespace in robots}
        self._errands = {
            name: Errands(namespace, config, partial(self._on_found, name))
            for name, namespace in zip(self._names, config.namespaces, strict=True)
        }
        self.subscribe(DiagnosticArray, "/diagnostics", self._on_diagnostics, QUEUE, raw=True)
        self.create_timer(_LOOK_PERIOD, self._look_around, clock=self.steady_clock)
        self._put_services()
        print(f"Page: {self.server.url}", flush=True)
        self._opened = OpenedPage(self.server.url) if config.open_browser else None

    def _on_request(self, request: Request, reply: Reply) -> None:
        """Hand a request on; called in the server's thread."""
        if request.kind != "record":
            self._errands[request.robot].add(request, reply)
        elif self._recording is not None:
            self._recording.add(request.is_on, reply)
        else:
            reply("recording is off: start diffbot watch with --record FOLDER", 2)

    def _on_found(self, name: str, found: Found) -> None:
        """Take what the graph of a robot has; called in the thread of its errands."""
        if name == self._names[0]:
            self._found_services = found.services
            self._put_services()
        if found.docking is not None:
            self._robots[name].set_docking(found.docking)
        if found.constants is not None:
            self._state.put("", "constants", {**self._constants, **found.constants})

    def _put_services(self) -> None:
        missing = {"isThere": False, "isOn": False}
        is_on = self._recording is not None and self._recording.is_on
        record = {"isThere": self._recording is not None, "isOn": is_on}
        self._state.put("", "services", {"pause": missing, "reset": missing, **self._found_services, "record": record})

    def _on_diagnostics(self, data: bytes) -> None:
        try:
            statuses = read_statuses(data)
        except CdrError as error:
            raise BadMessageError("unreadable", str(error)) from None
        for status in statuses:
            self._diagnoses[status.name] = time.monotonic(), status
        for robot in self._robots.values():
            robot.on_diagnostics(statuses)
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

    def _look_around(self) -> None:
        types = dict(self.get_topic_names_and_types())
        self._present = {f"{space.rstrip('/')}/{name}" for name, space in self.get_node_names_and_namespaces()}
        for robot in self._robots.values():
            robot.look_for_types(types)
            robot.look_for_silence()
        if self._diagnoses:
            self._put_diagnoses()
        self._put_services()

    def health_level(self) -> tuple[int, str]:
        """Return level and message for /diagnostics, which also stand on the page."""
        found = [super().health_level()]
        if self._recording is not None and self._recording.problem:
            found.append((DiagnosticStatus.ERROR[0], self._recording.problem))
        if self._diagnoses.dropped:
            found.append((DiagnosticStatus.WARN[0], f"{self._diagnoses.dropped} names dropped, {MAX_NODES} are shown"))
        return max(found, key=lambda one: one[0])

    def before_shutdown(self) -> None:
        """Close the page, the errands and a recording."""
        if self._opened is not None:
            self._opened.close()
        self.server.stop()
        for errands in self._errands.values():
            errands.stop()
        if self._recording is not None:
            self._recording.close()


def main(args: list[str] | None = None) -> int:
    """Run the node; return the exit status of the process."""
    return run(WatchNode, args)
