"""Observes a running robot: subscribes to its topics, asks its nodes for their parameters, looks at the graph."""

from __future__ import annotations

import importlib
import os
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import partial
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient
from rclpy.signals import SignalHandlerOptions

from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_control.ros.tf import transforms_of
from diffbot_control.ros.transforms import LastTransform
from diffbot_core.endpoints import AUTO, TYPE_WORDS
from diffbot_core.ros.qos import LATCHED, SENSOR
from diffbot_core.ros.watches import CLOCK_TOPIC, bases_elsewhere, published_elsewhere, publishers_of, subscriptions_of
from diffbot_core.schema import build, parameters_of
from diffbot_tools.live.report import (
    Line,
    Robot,
    TopicGraph,
    input_lines,
    node_lines,
    output_lines,
    sim_time_problems,
)
from diffbot_tools.live.streams import COMMANDS, Arrival, Streams

_NAME = "diffbot_check"
_DISCOVERY = 2.0
"""[s] for which the graph is discovered before topics are subscribed"""
_LOOK = 0.5
"""[s] between two looks for topics that nobody published before"""
_ANSWER, _ATTEMPTS = 1.0, 5
"""[s] for an answer with parameters, and how often a node is asked"""
_NODES = "ekf", "controller"
_ODOMETRY, _IMU, _JOINTS = "nav_msgs/msg/Odometry", "sensor_msgs/msg/Imu", "sensor_msgs/msg/JointState"
_POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"
_MORE = {"odom": _ODOMETRY, "joint_states": _JOINTS, "imu": _IMU, "heading": _IMU}
_OUTPUTS = {"pose": (_POSE,), "odometry/filtered": (_ODOMETRY,), COMMANDS: tuple(TYPE_WORDS)}


class Observer:
    """A node that looks on for a while."""

    def __init__(self, namespace: str, values: Mapping[str, Mapping[str, Any]], ros_arguments: list[str]) -> None:
        """Join the graph.

        Args:
            namespace: of the robot.
            values: parameters of the ekf and the controller from a file; those of a running node replace them.
            ros_arguments: remappings.
        """
        # Shared memory of a process that was killed can hold messages up.
        os.environ.setdefault("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4")
        context = rclpy.Context()
        words = ["--ros-args", *ros_arguments] if ros_arguments else []
        rclpy.init(args=words, context=context, signal_handler_options=SignalHandlerOptions.NO)
        self._node = Node(_NAME, namespace=namespace, context=context, start_parameter_services=False)
        self._executor = SingleThreadedExecutor(context=context)
        self._executor.add_node(self._node)
        self._values = {name: dict(values.get(name, {})) for name in _NODES}
        self._use_sim_time: dict[str, bool] = {}
        self._states: dict[str, tuple[int, str]] = {}
        self._simulated: int | None = None

    def close(self) -> None:
        """Leave the graph."""
        self._executor.shutdown()
        self._node.destroy_node()
        self._node.context.try_shutdown()

    def observe(self, duration: float) -> tuple[list[Line], bool]:
        """Look on for ``duration`` [s]; return the lines, and True if the robot has moved meanwhile."""
        node = self._node
        node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)
        self._spin(_DISCOVERY)
        self._read_parameters()
        config = build(EkfNodeConfig, self._values["ekf"])
        streams = Streams(config, LastTransform(partial(transforms_of, node, config.sensor_timeout)))
        inputs = {name: (kind,) for name, kind in _MORE.items()}
        inputs |= {name: (one.message_type,) for name, one in streams.sensors.items()}
        topics = {name: self._topic(name, kinds, name in inputs) for name, kinds in (inputs | _OUTPUTS).items()}
        deadline, subscribed = time.monotonic() + duration, set[str]()
        while (left := deadline - time.monotonic()) > 0.0:
            for name, kinds in (inputs | _OUTPUTS).items():  # what is discovered late counts as well
                if name not in subscribed and self._subscribe(streams, name, topics[name], kinds):
                    subscribed.add(name)
            if CLOCK_TOPIC not in subscribed and publishers_of(node, CLOCK_TOPIC):
                self._subscribe_clock()
                subscribed.add(CLOCK_TOPIC)
            self._spin(min(left, _LOOK))
        return self._lines(streams, inputs, topics, duration), streams.has_moved or bool(streams.watch.odometry.fault())

    def _lines(
        self, streams: Streams, inputs: Mapping[str, tuple[str, ...]], topics: Mapping[str, str], duration: float
    ) -> list[Line]:
        node, names = self._node, {name: self._full_name(name) for name in _NODES}
        found = self._running()
        copies = {full: found.count(full) for full in names.values()}
        running = {name: full if copies[full] else "" for name, full in names.items()}
        values = self._values["controller"]
        timeout, kind = float(values.get("pose_timeout", 0.5)), str(values.get("cmd_vel_type", AUTO))
        robot = Robot(running["ekf"], running["controller"], kind, timeout, self._use_sim_time)
        graphs = {name: self._graph(name, topics[name], kinds) for name, kinds in inputs.items()}
        lines = input_lines(graphs, streams, robot, duration)
        outputs = {name: self._graph(name, topics[name], kinds) for name, kinds in _OUTPUTS.items()}
        lines += output_lines(outputs, streams, robot, duration)
        clocks = publishers_of(node, CLOCK_TOPIC)
        if (problems := sim_time_problems(robot, streams, bool(clocks))) or clocks:
            problems += [f"{len(clocks)} publishers, only one may own time: end one"] if len(clocks) > 1 else []
            sources = ", ".join(sorted({one.node for one in clocks})) or "nobody"
            lines.append(Line(CLOCK_TOPIC, (f"from {sources}",), tuple(problems)))
        silent = [full for full in running.values() if full and full not in self._use_sim_time]
        text = "its parameters could not be read, so that those of the file, or the defaults, were assumed: check again"
        lines += [Line(full, notes=(text,)) for full in silent]
        return lines + node_lines(self._states, copies, [text for one in lines for text in one.todo])

    def _graph(self, name: str, topic: str, kinds: tuple[str, ...]) -> TopicGraph:
        node = self._node
        publishers, subscriptions = publishers_of(node, topic), subscriptions_of(node, topic)
        elsewhere: list[str] = []
        if name == COMMANDS:
            elsewhere = bases_elsewhere(node, topic)
        elif not publishers:
            outputs = {node.resolve_topic_name(one) for one in _OUTPUTS}
            elsewhere = [one for one in published_elsewhere(node, topic, kinds[0]) if one not in outputs]
        own = node.get_fully_qualified_name()
        return TopicGraph(topic, kinds, publishers, [one for one in subscriptions if one.node != own], elsewhere)

    def _topic(self, name: str, kinds: tuple[str, ...], is_input: bool) -> str:
        """Return the topic to which the running node has remapped ``name``; without one, as this node resolves it."""
        default: str = self._node.resolve_topic_name(name)
        owner = "controller" if name == COMMANDS else "ekf"
        find = self._node.get_subscriber_names_and_types_by_node
        if not is_input:
            find = self._node.get_publisher_names_and_types_by_node
        with suppress(Exception):  # rclpy raises several types for a node that does not run
            found = find(owner, self._node.get_namespace())
            usual = {self._node.resolve_topic_name(one) for one in (*_MORE, *_OUTPUTS, "global_pose", "initialpose")}
            own = [topic for topic, types in found if set(kinds) & set(types)]
            others = [topic for topic in own if topic not in usual]
            if default not in own and len(others) == 1:
                return str(others[0])
        return default

    def _running(self) -> list[str]:
        """Return the full names of all nodes, one for each."""
        return [f"{space.rstrip('/')}/{one}" for one, space in self._node.get_node_names_and_namespaces()]

    def _full_name(self, name: str) -> str:
        return f"{self._node.get_namespace().rstrip('/')}/{name}"

    def _read_parameters(self) -> None:
        """Replace the values of a file by those of nodes that run."""
        wanted = {
            "ekf": [one.name for one in parameters_of(EkfNodeConfig)],
            "controller": ["pose_timeout", "cmd_vel_type"],
        }
        running = self._running()
        for name in _NODES:
            client = AsyncParameterClient(self._node, self._full_name(name))
            if self._full_name(name) not in running or not client.wait_for_services(_ANSWER):
                continue
            names = [*wanted[name], "use_sim_time"]
            for _ in range(_ATTEMPTS):  # DDS drops the response to a client that the node has not discovered yet
                future = client.get_parameters(names)
                self._spin(_ANSWER, future.done)
                if future.done():
                    break
            if not future.done() or len(future.result().values) != len(names):
                continue
            values = dict(zip(names, map(parameter_value_to_python, future.result().values), strict=True))
            self._use_sim_time[self._full_name(name)] = bool(values.pop("use_sim_time"))
            self._values[name] = {key: _plain(value) for key, value in values.items() if value is not None}

    def _subscribe(self, streams: Streams, name: str, topic: str, kinds: tuple[str, ...]) -> bool:
        """Subscribe to a topic if it is published in one of its types; return True if it is."""
        matching = [one for one in publishers_of(self._node, topic) if one.type in kinds]
        if not matching:
            return False
        package, _, word = matching[0].type.split("/")
        kind = getattr(importlib.import_module(f"{package}.msg"), word)
        is_latched = all(one.is_latched for one in matching)
        self._node.create_subscription(
            kind, topic, partial(self._receive, streams, name), LATCHED if is_latched else SENSOR
        )
        return True

    def _receive(self, streams: Streams, name: str, message: Any) -> None:
        streams.add(name, message, Arrival(time.monotonic(), time.time_ns(), self._simulated))

    def _subscribe_clock(self) -> None:
        from rosgraph_msgs.msg import Clock  # noqa: PLC0415

        def receive(message: Any) -> None:
            self._simulated = message.clock.sec * 1_000_000_000 + message.clock.nanosec

        self._node.create_subscription(Clock, CLOCK_TOPIC, receive, SENSOR)

    def _on_diagnostics(self, message: Any) -> None:
        for one in message.status:
            self._states[one.name] = one.level[0], one.message

    def _spin(self, duration: float, is_done: Callable[[], bool] = lambda: False) -> None:
        deadline = time.monotonic() + duration
        while time.monotonic() < deadline and not is_done():
            self._executor.spin_once(timeout_sec=0.05)


def _plain(value: Any) -> Any:
    """Return a value of a parameter as a parameter file would have it: arrays as lists."""
    return value if isinstance(value, bool | int | float | str) else list(value)
