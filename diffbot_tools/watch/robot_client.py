"""Sends requests of browsers to one robot, in a thread of its own, and answers every request."""

from __future__ import annotations

import math
import queue
import threading
from collections.abc import Callable
from typing import Any, NamedTuple

from rcl_interfaces.srv import GetParameters
from rclpy import Context
from rclpy.parameter import parameter_value_to_python
from std_srvs.srv import SetBool, Trigger

from diffbot_control.goals import record as goal_record
from diffbot_control.law.configuration import DockingConfig, SwitchingConfig
from diffbot_control.law.docking_axis import pose_on_axis
from diffbot_control.ros.goals.client import GoalClient
from diffbot_control.ros.messages.conversions import goal_message
from diffbot_control.ros.navigator import Navigator
from diffbot_core.errors import DiffbotError, InvalidValueError
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import WheelGeometry
from diffbot_core.schema import parameters_of
from diffbot_tools.view.constants import constants_of, recorded_config, recorded_wheels
from diffbot_tools.view.requests import Request
from diffbot_tools.view.server import Reply
from diffbot_tools.watch.parameters import WatchConfig

MAX_WAITING = 20
"""Number of requests in the queue. Further requests are refused."""
SERVICE_TIMEOUT = 3.0
_TRIALS = 3
"""Number of attempts to call a service: the response is lost if the node has not discovered the client yet."""
_IDLE, _FOLLOWING = 0.5, 0.03
"""[s] Longest wait for a request, without and with a goal under way."""
_PARAMETERS = (*(one.name for one in parameters_of(SwitchingConfig)), *WheelGeometry._fields)
_DOCKING = ("staging_distance", "dock_backward")

Services = dict[str, dict[str, bool]]


class RobotInfo(NamedTuple):
    """Services and parameters of one robot."""

    services: Services
    """``isThere`` and ``isOn`` of pause, reset and dock"""
    constants: dict[str, Any] | None
    """tolerances and limits of the controller, see constants.py; None if the controller has not sent its parameters"""
    docking: DockingConfig | None
    """parameters of the docking controller; None if it has not sent them"""


class RobotClient:
    """Handles the requests for one robot in their order, and reports how the newest goal ends."""

    def __init__(
        self, namespace: str, config: WatchConfig, context: Context, on_info: Callable[[RobotInfo], None]
    ) -> None:
        """Start the thread, which calls ``on_info`` whenever services or parameters of the robot have changed.

        Another node has to use the same ``context`` until :meth:`stop` has returned. Otherwise Fast DDS would destroy
        the participant there, and may hang; see :func:`diffbot_core.ros.run.forced_exit`.
        """
        self._namespace, self._config, self._on_info = namespace.strip("/"), config, on_info
        self._context = context
        self._requests: queue.Queue[tuple[Request, Reply]] = queue.Queue(MAX_WAITING)
        self._stopped = threading.Event()
        self._is_paused = False
        self._constants: dict[str, Any] | None = None
        self._docking: DockingConfig | None = None
        self._last_info: RobotInfo | None = None
        self._thread = threading.Thread(target=self._run, name=f"requests {namespace}", daemon=True)
        self._thread.start()

    def add(self, request: Request, reply: Reply) -> None:
        """Queue a request and return at once. ``reply`` is called later."""
        try:
            self._requests.put_nowait((request, reply))
        except queue.Full:
            reply("busy: too many requests are waiting, try again", 1)

    def is_interrupted(self) -> bool:
        """Return True if the present request must not wait: the thread ends, or a cancellation is in the queue."""
        with self._requests.mutex:
            return self._stopped.is_set() or any(request.kind == "cancel" for request, _ in self._requests.queue)

    def stop(self) -> None:
        """End the thread. The robot continues to its goal."""
        self._stopped.set()
        self._thread.join(timeout=5.0)

    def _run(self) -> None:
        config = self._config
        self._client = Navigator(
            node_name="watch_client",
            namespace=self._namespace,
            controller=config.controller,
            frame=config.map_frame,
            context=self._context,
        )
        self._dock_client = GoalClient(
            "watch_dock_client",
            self._namespace,
            controller=config.dock_controller,
            frame="dock",
            prefix="dock/",
            context=self._context,
        )
        self._active: GoalClient = self._client
        """client of the newest goal"""
        for client in (self._client, self._dock_client):
            client.is_stopped = self.is_interrupted
        self._services = {
            "cancel": self._client.create_client(Trigger, f"{config.controller}/cancel"),
            "cancel_dock": self._client.create_client(Trigger, f"{config.dock_controller}/cancel"),
            "reset": self._client.create_client(Trigger, f"{config.plant}/reset"),
            "forget": self._client.create_client(Trigger, f"{config.ekf}/reset"),
            "pause": self._client.create_client(SetBool, f"{config.plant}/pause"),
            "parameters": self._client.create_client(GetParameters, f"{config.controller}/get_parameters"),
            "docking": self._client.create_client(GetParameters, f"{config.dock_controller}/get_parameters"),
        }
        goal_reply: Reply | None = None
        try:
            while not self._stopped.is_set():
                try:
                    request, reply = self._requests.get(timeout=_IDLE if goal_reply is None else _FOLLOWING)
                except queue.Empty:
                    goal_reply = self._follow(goal_reply)
                    continue
                goal_reply = self._handle(request, reply, goal_reply)
        finally:
            self._dock_client.close(shut_down=False)
            self._client.close(shut_down=False)

    def _follow(self, goal_reply: Reply | None) -> Reply | None:
        """If the goal under way has ended, report its end; without a goal, update services and parameters."""
        if goal_reply is None:
            self._update_info()
            return None
        if not self._active.wait_for_end(_FOLLOWING):
            return goal_reply
        task = self._active.task
        goal_reply(f"goal {task.text}", 0 if task.end in (goal_record.REACHED, goal_record.CANCELLED) else 2)
        return None

    def _handle(self, request: Request, reply: Reply, goal_reply: Reply | None) -> Reply | None:
        """Handle a request; return the function that replies when the goal under way ends, None without a goal."""
        try:
            if request.kind == "goal" and request.pose is not None:
                x, y, theta = request.pose
                text = f"goal accepted: x {x:.2f} m, y {y:.2f} m, {math.degrees(theta):.0f} deg"
                return self._send_goal(self._client, request.pose, text, reply)
            if request.kind in ("dock", "undock"):
                config = self._docking or DockingConfig()
                staging = pose_on_axis(config.staging_distance, config.dock_backward)
                pose = Pose(0.0, 0.0, 0.0) if request.kind == "dock" else staging
                return self._send_goal(self._dock_client, pose, f"{request.kind}: accepted", reply)
            text, level = self._call_services(request)
            reply(text, level)
        except DiffbotError as error:
            reply(str(error), 2)
        return goal_reply

    def _send_goal(self, client: GoalClient, pose: Pose, text: str, reply: Reply) -> Reply:
        client.send_goal([pose], timeout=10.0)
        self._active = client
        reply(text, 0)
        return reply

    def _call_services(self, request: Request) -> tuple[str, int]:
        """Handle a request that is not a goal; return text and level of the answer."""
        if request.kind == "initialpose" and request.pose is not None:
            # Not longer, because a cancellation waits meanwhile.
            message = goal_message(request.pose, self._config.map_frame, 0)
            done = self._client.setInitialPose(message, timeout=SERVICE_TIMEOUT)
            return ("initial pose set", 0) if done else ("the filter did not accept the initial pose", 2)
        if request.kind == "cancel":
            # Both controllers, since the goal may be of another client.
            names = [one for one in ("cancel_dock", "cancel") if self._services[one].service_is_ready()] or ["cancel"]
            return min((self._call(one, Trigger.Request()) for one in names), key=lambda answer: answer[1])
        if request.kind == "pause":
            text, level = self._call("pause", SetBool.Request(data=request.is_on))
            if level == 0:
                self._is_paused = request.is_on
                self._update_info()
            return text, level
        text, level = self._call("reset", Trigger.Request())
        if level == 0 and self._services["forget"].service_is_ready():
            self._call("forget", Trigger.Request())
        return text, level

    def _call(self, name: str, request: Any) -> tuple[str, int]:
        client = self._services[name]
        if not self._client.spin_until(client.service_is_ready, SERVICE_TIMEOUT):
            return f"{name.partition('_')[0]}: no node offers this service", 2
        for _ in range(_TRIALS):
            future = client.call_async(request)
            if self._client.spin_until(future.done, SERVICE_TIMEOUT / _TRIALS):
                answer = future.result()
                return f"{name.partition('_')[0]}: {answer.message or 'done'}", 0 if answer.success else 2
            client.remove_pending_request(future)
        return f"{name.partition('_')[0]}: no answer within {SERVICE_TIMEOUT:g} s", 2

    def _update_info(self) -> None:
        # A node that is started again may have other parameters, and its simulation is not paused.
        if not self._services["parameters"].service_is_ready():
            self._constants = None
        elif self._constants is None:
            self._constants = self._request_constants()
        if not self._services["docking"].service_is_ready():
            self._docking = None
        elif self._docking is None:
            values = self._request_parameters("docking", _DOCKING)
            # The docking controller may run another law, without these parameters.
            self._docking = DockingConfig()._replace(**values) if len(values) == len(_DOCKING) else None
        ready = {name: self._services[name].service_is_ready() for name in ("pause", "reset", "docking")}
        self._is_paused = self._is_paused and ready["pause"]
        services = {
            "pause": {"isThere": ready["pause"], "isOn": self._is_paused},
            "reset": {"isThere": ready["reset"], "isOn": False},
            "dock": {"isThere": ready["docking"], "isOn": False},
        }
        info = RobotInfo(services, self._constants, self._docking)
        if info != self._last_info:
            self._last_info = info
            self._on_info(info)

    def _request_parameters(self, service: str, names: tuple[str, ...]) -> dict[str, Any]:
        """Return the values of the parameters that the node has; empty without an answer."""
        client = self._services[service]
        future = client.call_async(GetParameters.Request(names=list(names)))
        if not self._client.spin_until(future.done, 1.0):
            client.remove_pending_request(future)
            return {}
        values = [parameter_value_to_python(value) for value in future.result().values]
        return {name: value for name, value in zip(names, values, strict=False) if value is not None}

    def _request_constants(self) -> dict[str, Any] | None:
        values = self._request_parameters("parameters", _PARAMETERS)
        if "xy_goal_tolerance" not in values:
            return None
        try:
            return constants_of(recorded_config(values), recorded_wheels({"/controller": values}, ""))
        except InvalidValueError:
            return None  # the controller runs another law, which has parameters of the same names
