"""The node of ``diffbot check``: subscribe to the topics of a robot, and read its parameters and the graph."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient
from rclpy.signals import SignalHandlerOptions
from rosgraph_msgs.msg import Clock

from diffbot_bag.conversions import message_class
from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_control.ros.sensors import POSE_MESSAGE
from diffbot_control.ros.tf import transforms_of
from diffbot_control.ros.transforms import LastTransform
from diffbot_core.endpoints import AUTO, TYPE_WORDS
from diffbot_core.ros.graph import bases_elsewhere, published_elsewhere, publishers_of, subscriptions_of
from diffbot_core.ros.qos import LATCHED, SENSOR
from diffbot_core.ros.watches import CLOCK_TOPIC
from diffbot_core.schema import build, parameters_of
from diffbot_core.stamps import NS_PER_S
from diffbot_tools.bringup import RELATIVE_TF
from diffbot_tools.check.report import (
    Line,
    ObservedRobot,
    TopicGraph,
    clock_lines,
    input_lines,
    node_lines,
    output_lines,
)
from diffbot_tools.check.streams import COMMANDS, MessageArrival, Streams

_DISCOVERY = 2.0
"""[s] time to discover the graph before subscribing"""
_LOOK = 0.5
"""[s] time between two searches for new publishers"""
_ANSWER, _ATTEMPTS = 1.0, 5
"""[s] time to wait for an answer with parameters, and number of requests to one node"""
_ODOMETRY, _IMU = "nav_msgs/msg/Odometry", "sensor_msgs/msg/Imu"
_INPUTS = {"odom": _ODOMETRY, "joint_states": "sensor_msgs/msg/JointState", "imu": _IMU, "heading": _IMU}
"""Inputs that are observed even if the ekf does not use them."""
_OUTPUTS = {"pose": (POSE_MESSAGE,), "odometry/filtered": (_ODOMETRY,), COMMANDS: tuple(TYPE_WORDS)}
_PARAMETERS = {
    "ekf": [*(one.name for one in parameters_of(EkfNodeConfig)), "use_sim_time"],
    "controller": ["pose_timeout", "cmd_vel_type", "max_cmd_vel_publishers", "use_sim_time"],
}
"""Parameters that are read from each node."""


class Observer:
    """A node that observes a robot for a limited time."""

    def __init__(self, namespace: str, values: Mapping[str, Mapping[str, Any]], ros_arguments: list[str]) -> None:
        """Join the graph.

        Args:
            namespace: namespace of the robot.
            values: parameters of ekf and controller from a file; the parameters of a running node replace them.
            ros_arguments: remappings.
        """
        # Shared memory that a killed process has left behind can delay the messages of Fast DDS.
        os.environ.setdefault("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4")
        context = rclpy.Context()
        words = ["--ros-args", *ros_arguments] if ros_arguments else []
        rclpy.init(args=words, context=context, signal_handler_options=SignalHandlerOptions.NO)
        self._node = Node("diffbot_check", namespace=namespace, context=context, start_parameter_services=False)
        self._executor = SingleThreadedExecutor(context=context)
        self._executor.add_node(self._node)
        self._names = {name: f"{self._node.get_namespace().rstrip('/')}/{name}" for name in _PARAMETERS}
        """full names of ekf and controller"""
        self._values = {name: dict(values.get(name, {})) for name in _PARAMETERS}
        self._use_sim_time: dict[str, bool] = {}
        self._states: dict[str, tuple[int, str]] = {}
        self._simulated_time: int | None = None

    def close(self) -> None:
        """Leave the graph."""
        nodes = {self._node, *self._executor.get_nodes()}
        self._executor.shutdown()
        for node in nodes:
            node.destroy_node()
        self._node.context.try_shutdown()

    def observe(self, duration: float) -> tuple[list[Line], bool]:
        """Observe for ``duration`` [s]; return the report, and True if the robot has moved meanwhile."""
        self._node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)
        self._node.create_subscription(Clock, CLOCK_TOPIC, self._on_clock, SENSOR)
        self._spin(_DISCOVERY)
        self._read_parameters()
        config = build(EkfNodeConfig, self._values["ekf"])
        transforms = LastTransform(lambda: transforms_of(self.transform_node(), config.sensor_timeout))
        streams = Streams(config, transforms)
        inputs = {name: (kind,) for name, kind in _INPUTS.items()}
        inputs |= {name: (one.message_type,) for name, one in streams.sensors.items()}
        kinds = inputs | _OUTPUTS
        topics = {name: self._topic(name, kinds, is_input=name in inputs) for name in kinds}
        deadline, missing = time.monotonic() + duration, set(kinds)
        while (left := deadline - time.monotonic()) > 0.0:
            for name in sorted(missing):  # a publisher may be discovered late
                if self._subscribe(streams, name, topics[name], kinds[name]):
                    missing.remove(name)
            self._spin(min(left, _LOOK))
        graphs = {name: self._graph(name, topics[name], kinds[name][0]) for name in kinds}
        outputs = {name: graphs[name] for name in _OUTPUTS}
        return self._report({name: graphs[name] for name in inputs}, outputs, streams, duration), streams.has_moved

    def transform_node(self) -> Node:
        """Return a node that receives TF from the namespace of the robot if it is published there, else from /tf."""
        own = self._node.get_namespace().rstrip("/")
        if own and any(publishers_of(self._node, f"{own}/{name}") for _, name in RELATIVE_TF):
            rules = [word for old, new in RELATIVE_TF for word in ("-r", f"{old}:={new}")]
            options = {"cli_args": ["--ros-args", *rules], "context": self._node.context}
            node = Node("diffbot_check_tf", namespace=own, start_parameter_services=False, **options)
            self._executor.add_node(node)
            return node
        return self._node

    def _report(
        self, inputs: Mapping[str, TopicGraph], outputs: Mapping[str, TopicGraph], streams: Streams, duration: float
    ) -> list[Line]:
        nodes, values = self._running(), self._values["controller"]
        running = {name: full if full in nodes else "" for name, full in self._names.items()}
        robot = ObservedRobot(
            ekf=running["ekf"],
            controller=running["controller"],
            cmd_vel_type=str(values.get("cmd_vel_type", AUTO)),
            pose_timeout=float(values.get("pose_timeout", 0.5)),
            max_cmd_vel_publishers=int(values.get("max_cmd_vel_publishers", 1)),
            use_sim_time=self._use_sim_time,
        )
        clock = TopicGraph(CLOCK_TOPIC, publishers=publishers_of(self._node, CLOCK_TOPIC))
        lines = [
            *input_lines(inputs, streams, robot, duration),
            *output_lines(outputs, streams, robot, duration),
            *clock_lines(clock, streams, robot),
        ]
        copies = {full: nodes.count(full) for full in self._names.values()}
        unread = [full for full in running.values() if full and full not in self._use_sim_time]
        return lines + node_lines(self._states, copies, unread, [text for one in lines for text in one.todo])

    def _graph(self, name: str, topic: str, kind: str) -> TopicGraph:
        node = self._node
        publishers, subscriptions = publishers_of(node, topic), subscriptions_of(node, topic)
        elsewhere: list[str] = []
        if name == COMMANDS:
            elsewhere = bases_elsewhere(node, topic)
        elif not publishers:
            outputs = {node.resolve_topic_name(one) for one in _OUTPUTS}
            elsewhere = [one for one in published_elsewhere(node, topic, kind) if one not in outputs]
        own = node.get_fully_qualified_name()
        return TopicGraph(topic, kind, publishers, [one for one in subscriptions if one.node != own], elsewhere)

    def _topic(self, name: str, kinds: Mapping[str, tuple[str, ...]], *, is_input: bool) -> str:
        """Return the topic to which a running node has remapped ``name``; without such a node, the resolved name.

        ``kinds`` has the types of each input and output by its name.
        """
        node = self._node
        default: str = node.resolve_topic_name(name)
        find = node.get_subscriber_names_and_types_by_node if is_input else node.get_publisher_names_and_types_by_node
        with suppress(Exception):  # rclpy raises several types for a node that does not run
            found = find("controller" if name == COMMANDS else "ekf", node.get_namespace())
            usual = {node.resolve_topic_name(one) for one in (*kinds, "initialpose")}
            topics = [topic for topic, types in found if set(kinds[name]) & set(types)]
            others = [topic for topic in topics if topic not in usual]
            if default not in topics and len(others) == 1:
                return str(others[0])
        return default

    def _running(self) -> list[str]:
        """Return the full names of all nodes; the list contains the name of two nodes of the same name twice."""
        return [f"{space.rstrip('/')}/{one}" for one, space in self._node.get_node_names_and_namespaces()]

    def _read_parameters(self) -> None:
        """Read the parameters of running nodes, which replace the values of a file."""
        running = self._running()
        for name, full in self._names.items():
            client = AsyncParameterClient(self._node, full)
            if full not in running or not client.wait_for_services(_ANSWER):
                continue
            names = _PARAMETERS[name]
            for _ in range(_ATTEMPTS):  # DDS drops the response to a client that the node has not discovered yet
                future = client.get_parameters(names)
                self._spin(_ANSWER, future.done)
                if future.done():
                    break
            if not future.done() or len(future.result().values) != len(names):
                continue
            values = dict(zip(names, map(parameter_value_to_python, future.result().values), strict=True))
            self._use_sim_time[full] = bool(values.pop("use_sim_time"))
            self._values[name] = {key: _plain(value) for key, value in values.items() if value is not None}

    def _subscribe(self, streams: Streams, name: str, topic: str, kinds: tuple[str, ...]) -> bool:
        """Subscribe to a topic if it is published in one of its types; return True if it is."""
        matching = [one for one in publishers_of(self._node, topic) if one.type in kinds]
        if not matching:
            return False

        def receive(message: Any) -> None:
            streams.add(name, message, MessageArrival(time.monotonic(), time.time_ns(), self._simulated_time))

        qos = LATCHED if all(one.is_latched for one in matching) else SENSOR
        self._node.create_subscription(message_class(matching[0].type), topic, receive, qos)
        return True

    def _on_clock(self, message: Any) -> None:
        self._simulated_time = message.clock.sec * NS_PER_S + message.clock.nanosec

    def _on_diagnostics(self, message: Any) -> None:
        for one in message.status:
            self._states[one.name] = one.level[0], one.message

    def _spin(self, duration: float, is_done: Callable[[], bool] = lambda: False) -> None:
        deadline = time.monotonic() + duration
        while time.monotonic() < deadline and not is_done():
            self._executor.spin_once(timeout_sec=0.05)


def _plain(value: Any) -> Any:
    """Return the value of a parameter as a parameter file has it: arrays as lists."""
    return value if isinstance(value, bool | int | float | str) else list(value)
