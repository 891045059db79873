"""Does what browsers request of one robot, in a thread of its own, so that every request gets its answer."""

from __future__ import annotations

import math
import queue
import threading
from collections.abc import Callable
from typing import Any, NamedTuple

from rcl_interfaces.srv import GetParameters
from rclpy.parameter import parameter_value_to_python
from std_srvs.srv import SetBool, Trigger

from diffbot_control.goals import record as goal_record
from diffbot_control.law.configuration import SwitchingConfig
from diffbot_control.law.docking_axis import DockingConfig, pose_on_axis
from diffbot_control.ros.goals.client import GoalClient
from diffbot_control.ros.messages.conversions import goal_message
from diffbot_control.ros.navigator import Navigator
from diffbot_core.errors import DiffbotError, InvalidValueError
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import WheelGeometry
from diffbot_core.schema import parameters_of
from diffbot_tools.view.constants import constants_of, recorded_config, recorded_wheels
from diffbot_tools.view.intake import Request
from diffbot_tools.view.server import Reply
from diffbot_tools.watch.parameters import WatchConfig

MAX_WAITING = 20
"""Requests in the queue; more are refused."""
SERVICE_TIMEOUT = 3.0
_TRIALS = 3
"""Calls of a service: a node drops its response to a client that it has not discovered yet."""
_IDLE, _FOLLOWING = 0.5, 0.03
_PARAMETERS = (*(one.name for one in parameters_of(SwitchingConfig)), *WheelGeometry._fields)
_DOCKING = ("staging_distance", "dock_backward")

Services = dict[str, dict[str, bool]]


class Found(NamedTuple):
    """What was found in the graph of one robot."""

    services: Services
    """``isThere`` and ``isOn`` of pause, reset and dock"""
    constants: dict[str, Any] | None
    """tolerances and limits of the controller; None if it has not answered"""
    docking: DockingConfig | None
    """how the robot docks; None if the node that docks has not answered"""


class Errands:
    """Does the requests for one robot in their order; follows a goal until it ends or another one is accepted."""

    def __init__(self, namespace: str, config: WatchConfig, on_found: Callable[[Found], None]) -> None:
        """Start the thread, which calls ``on_found`` whenever the graph of the robot has changed."""
        self._namespace, self._config, self._on_found = namespace.strip("/"), config, on_found
        self._requests: queue.Queue[tuple[Request, Reply]] = queue.Queue(MAX_WAITING)
        self._stopped = threading.Event()
        self._is_paused = False
        self._constants: dict[str, Any] | None = None
        self._docking: DockingConfig | None = None
        self._last_found: Found | None = None
        self._thread = threading.Thread(target=self._run, name=f"errands {namespace}", daemon=True)
        self._thread.start()

    def add(self, request: Request, reply: Reply) -> None:
        """Queue a request and return at once; the answers come later."""
        try:
            self._requests.put_nowait((request, reply))
        except queue.Full:
            reply("busy: too many requests are waiting", 1)

    def stop(self) -> None:
        """End the thread; the robot continues to its goal."""
        self._stopped.set()
        self._thread.join(timeout=5.0)

    def _run(self) -> None:
        self._client: Navigator = Navigator.in_own_context(
            node_name="watch_client",
            namespace=self._namespace,
            controller=self._config.controller,
            frame=self._config.map_frame,
        )
        config = self._config
        self._dock_client: GoalClient = GoalClient(
            "watch_dock_client",
            self._namespace,
            controller=config.dock_controller,
            frame="dock",
            prefix="dock/",
            context=self._client.context,
        )
        self._present: GoalClient = self._client
        for client in (self._client, self._dock_client):
            client.is_stopped = self._stopped.is_set
        self._services = {
            "cancel": self._client.create_client(Trigger, f"{config.controller}/cancel"),
            "cancel_dock": self._client.create_client(Trigger, f"{config.dock_controller}/cancel"),
            "reset": self._client.create_client(Trigger, f"{config.plant}/reset"),
            "forget": self._client.create_client(Trigger, f"{config.ekf}/reset"),
            "pause": self._client.create_client(SetBool, f"{config.plant}/pause"),
            "parameters": self._client.create_client(GetParameters, f"{config.controller}/get_parameters"),
            "docking": self._client.create_client(GetParameters, f"{config.dock_controller}/get_parameters"),
        }
        follower: Reply | None = None
        try:
            while not self._stopped.is_set():
                try:
                    request, reply = self._requests.get(timeout=_IDLE if follower is None else _FOLLOWING)
                except queue.Empty:
                    follower = self._follow(follower)
                    continue
                follower = self._do(request, reply, follower)
        finally:
            self._dock_client.close(shut_down=False)
            self._client.close()

    def _follow(self, follower: Reply | None) -> Reply | None:
        """Wait a moment for the end of the goal under way; without a goal, look at the graph."""
        if follower is None:
            self._look_around()
            return None
        if not self._present.wait_for_end(_FOLLOWING):
            return follower
        task = self._present.task
        follower(f"goal {task.text}", 0 if task.end in (goal_record.REACHED, goal_record.CANCELLED) else 2)
        return None

    def _do(self, request: Request, reply: Reply, follower: Reply | None) -> Reply | None:
        """Do a request; return the reply for the end of the goal under way, None without a goal."""
        try:
            if request.kind == "goal" and request.pose is not None:
                x, y, theta = request.pose
                words = f"goal accepted: x {x:.2f} m, y {y:.2f} m, {math.degrees(theta):.0f} deg"
                return self._send_goal(self._client, request.pose, words, reply)
            if request.kind in ("dock", "undock"):
                return self._send_to_dock(request.kind, reply)
            text, level = self._other(request)
            reply(text, level)
        except DiffbotError as error:
            reply(str(error), 2)
        return follower

    def _send_goal(self, client: GoalClient, pose: Pose, words: str, reply: Reply) -> Reply:
        client.send_goal([pose], timeout=10.0)
        self._present = client
        reply(words, 0)
        return reply

    def _send_to_dock(self, kind: str, reply: Reply) -> Reply:
        config = self._docking or DockingConfig()
        out = pose_on_axis(config.staging_distance, config.dock_backward)
        pose = Pose(0.0, 0.0, 0.0) if kind == "dock" else out
        return self._send_goal(self._dock_client, pose, f"{kind}: accepted", reply)

    def _other(self, request: Request) -> tuple[str, int]:
        if request.kind == "initialpose" and request.pose is not None:
            done = self._client.setInitialPose(goal_message(request.pose, self._config.map_frame, 0))
            return ("initial pose set", 0) if done else ("the filter did not take the initial pose", 2)
        if request.kind == "cancel":
            is_docking = self._present is self._dock_client and not self._dock_client.task.end
            return self._call("cancel_dock" if is_docking else "cancel", Trigger.Request())
        if request.kind == "pause":
            text, level = self._call("pause", SetBool.Request(data=request.is_on))
            if level == 0:
                self._is_paused = request.is_on
                self._look_around()
            return text, level
        text, level = self._call("reset", Trigger.Request())
        if level == 0 and self._services["forget"].service_is_ready():
            self._call("forget", Trigger.Request())
        return text, level

    def _call(self, name: str, request: Any) -> tuple[str, int]:
        client = self._services[name]
        if not self._client.spin_until(client.service_is_ready, SERVICE_TIMEOUT):
            return f"{name.partition('_')[0]}: no node offers it", 2
        for _ in range(_TRIALS):
            future = client.call_async(request)
            if self._client.spin_until(future.done, SERVICE_TIMEOUT / _TRIALS):
                answer = future.result()
                return f"{name.partition('_')[0]}: {answer.message or 'done'}", 0 if answer.success else 2
            client.remove_pending_request(future)
        return f"{name.partition('_')[0]}: no answer", 2

    def _look_around(self) -> None:
        if self._constants is None and self._services["parameters"].service_is_ready():
            self._constants = self._ask_constants()
        if self._docking is None and self._services["docking"].service_is_ready():
            self._docking = self._ask_docking()
        services = {
            name: {"isThere": self._services[name].service_is_ready(), "isOn": False} for name in ("pause", "reset")
        }
        services["pause"]["isOn"] = self._is_paused
        services["dock"] = {"isThere": self._services["docking"].service_is_ready(), "isOn": False}
        found = Found(services, self._constants, self._docking)
        if found != self._last_found:
            self._last_found = found
            self._on_found(found)

    def _ask(self, service: str, names: tuple[str, ...]) -> dict[str, Any]:
        """Return the parameters that the node of a service has; none without an answer."""
        client = self._services[service]
        future = client.call_async(GetParameters.Request(names=list(names)))
        if not self._client.spin_until(future.done, 1.0):
            client.remove_pending_request(future)
            return {}
        values = [parameter_value_to_python(value) for value in future.result().values]
        return {name: value for name, value in zip(names, values, strict=False) if value is not None}

    def _ask_docking(self) -> DockingConfig | None:
        values = self._ask("docking", _DOCKING)
        # The node may run another law than the docking law.
        return DockingConfig()._replace(**values) if len(values) == len(_DOCKING) else None

    def _ask_constants(self) -> dict[str, Any] | None:
        values = self._ask("parameters", _PARAMETERS)
        if "xy_goal_tolerance" not in values:
            return None
        try:
            return constants_of(recorded_config(values), recorded_wheels({"/controller": values}, ""))
        except InvalidValueError:
            return None  # of a controller with another law, only some parameters have names of this one
