"""What a browser asked for, done with one robot in a thread of its own, so that every request gets its answer."""

from __future__ import annotations

import math
import queue
import threading
from collections.abc import Callable
from typing import Any, NamedTuple

from rcl_interfaces.srv import GetParameters
from rclpy.parameter import parameter_value_to_python
from std_srvs.srv import SetBool, Trigger

from diffbot_control.goals import goal_record
from diffbot_control.law.docking_axis import DockingConfig
from diffbot_control.ros.messages.conversions import goal_message
from diffbot_control.ros.navigator import Navigator
from diffbot_core.errors import DiffbotError
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import WheelGeometry
from diffbot_tools.view.intake import Request
from diffbot_tools.view.server import Reply
from diffbot_tools.watch.parameters import WatchConfig

MAX_WAITING = 20
"""requests that wait for the one before"""
SERVICE_TIMEOUT = 3.0
_TRIALS = 3
"""calls of a service: a node drops its response to a client that it has not discovered yet"""
_IDLE, _FOLLOWING = 0.5, 0.03
_PARAMETERS = (
    "xy_goal_tolerance",
    "yaw_goal_tolerance",
    "linear.x.max_velocity",
    "angular.z.max_velocity",
    "wheel.max_velocity",
    *WheelGeometry._fields,
)
_DOCKING = ("staging_distance", "approach_length", "corridor", "dock_backward")

Services = dict[str, dict[str, bool]]


class Found(NamedTuple):
    """What the graph of one robot has."""

    services: Services
    """pause and reset: whether they are there and on"""
    constants: dict[str, Any] | None
    """tolerances and limits of the controller; None if it has not answered"""
    docking: DockingConfig | None
    """how the robot docks, as far as the page shows it; likewise"""


class Errands:
    """Does the requests for one robot in their order; a goal is followed until the next request."""

    def __init__(self, namespace: str, config: WatchConfig, on_found: Callable[[Found], None]) -> None:
        """Start the thread; ``on_found`` is called in it when something of the graph has changed."""
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
        """Take a request; answers come later. Returns at once."""
        try:
            self._requests.put_nowait((request, reply))
        except queue.Full:
            reply("busy: too many requests are waiting", 1)

    def stop(self) -> None:
        """End the thread; a goal under way goes on."""
        self._stopped.set()
        self._thread.join(timeout=5.0)

    def _run(self) -> None:
        self._client: Navigator = Navigator.in_own_context(
            node_name="watch_client",
            namespace=self._namespace,
            controller=self._config.controller,
            frame=self._config.map_frame,
        )
        self._client.is_stopped = self._stopped.is_set
        config = self._config
        self._services = {
            "cancel": self._client.create_client(Trigger, f"{config.controller}/cancel"),
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
            self._client.close()

    def _follow(self, follower: Reply | None) -> Reply | None:
        """Look after the goal under way, if there is one; else at the graph."""
        if follower is None:
            self._look_around()
            return None
        if not self._client.wait_for_end(_FOLLOWING):
            return follower
        end = self._client.task.end
        follower(f"goal {self._client.getReason()}", 0 if end in (goal_record.REACHED, goal_record.CANCELLED) else 2)
        return None

    def _do(self, request: Request, reply: Reply, follower: Reply | None) -> Reply | None:
        """Do a request; return who is to be told how the goal ends."""
        try:
            if request.kind == "goal" and request.pose is not None:
                return self._send_goal(request.pose, reply)
            text, level = self._other(request)
            reply(text, level)
        except DiffbotError as error:
            reply(str(error), 2)
        return follower

    def _send_goal(self, pose: Pose, reply: Reply) -> Reply:
        self._client.send_goal([pose], timeout=10.0)
        reply(f"goal accepted: x {pose.x:.2f} m, y {pose.y:.2f} m, {math.degrees(pose.theta):.0f} deg", 0)
        return reply

    def _other(self, request: Request) -> tuple[str, int]:
        if request.kind == "initialpose" and request.pose is not None:
            done = self._client.setInitialPose(goal_message(request.pose, self._config.map_frame, 0))
            return ("initial pose set", 0) if done else ("the filter did not take the initial pose", 2)
        if request.kind == "cancel":
            return self._call("cancel", Trigger.Request())
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
            return f"{name}: no node offers it", 2
        for _ in range(_TRIALS):
            future = client.call_async(request)
            if self._client.spin_until(future.done, SERVICE_TIMEOUT / _TRIALS):
                answer = future.result()
                return f"{name}: {answer.message or 'done'}", 0 if answer.success else 2
            client.remove_pending_request(future)
        return f"{name}: no answer", 2

    def _look_around(self) -> None:
        if self._constants is None and self._services["parameters"].service_is_ready():
            self._constants = self._ask_constants()
        if self._docking is None and self._services["docking"].service_is_ready():
            self._docking = self._ask_docking()
        services = {
            name: {"isThere": self._services[name].service_is_ready(), "isOn": False} for name in ("pause", "reset")
        }
        services["pause"]["isOn"] = self._is_paused
        found = Found(services, self._constants, self._docking)
        if found != self._last_found:
            self._last_found = found
            self._on_found(found)

    def _ask(self, service: str, names: tuple[str, ...]) -> list[Any]:
        """Return the values of parameters; none without an answer."""
        client = self._services[service]
        future = client.call_async(GetParameters.Request(names=list(names)))
        if not self._client.spin_until(future.done, 1.0):
            client.remove_pending_request(future)
            return []
        return [parameter_value_to_python(value) for value in future.result().values]

    def _ask_docking(self) -> DockingConfig | None:
        values = self._ask("docking", _DOCKING)
        if len(values) != len(_DOCKING) or None in values:
            return None  # its law is another one
        return DockingConfig()._replace(**dict(zip(_DOCKING, values, strict=True)))

    def _ask_constants(self) -> dict[str, Any] | None:
        values = self._ask("parameters", _PARAMETERS)
        finite = [value if isinstance(value, float) and math.isfinite(value) else None for value in values]
        if len(finite) != len(_PARAMETERS) or None in finite[:2]:
            return None
        xy, yaw, v, omega, wheel, *wheels = finite
        rim = None if wheel is None or wheels[0] is None else wheel * wheels[0]
        limits = {"v": v, "omega": omega, "rim": rim}
        return {
            "xy_tolerance": xy,
            "yaw_tolerance": yaw,
            "limits": limits,
            "wheels": None if None in wheels else wheels,
        }
