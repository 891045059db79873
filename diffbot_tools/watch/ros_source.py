"""Passes the messages of one running robot to its model."""

from __future__ import annotations

import time
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, TwistStamped
from geometry_msgs.msg import Twist as TwistMessage
from nav_msgs.msg import Odometry, Path
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Float64MultiArray

from diffbot_core.ros.node import DiffbotNode
from diffbot_core.ros.qos import LATCHED, QUEUE, SENSOR
from diffbot_tools.view.live_state import LiveState, RobotSink
from diffbot_tools.view.model import RobotModel
from diffbot_tools.view.texts import ERROR, OK, WARNING
from diffbot_tools.view.track import PageClock
from diffbot_tools.watch.parameters import WatchConfig

SILENCE = 2.0
"""[s] The page reports a controller that sends no status for this time; a status is due every 0.5 s."""
_TYPES_OF = {
    "cmd_vel": ("command", {"geometry_msgs/msg/Twist": TwistMessage, "geometry_msgs/msg/TwistStamped": TwistStamped}),
    "detected_dock_pose": (
        "detections",
        {
            "geometry_msgs/msg/PoseStamped": PoseStamped,
            "geometry_msgs/msg/PoseWithCovarianceStamped": PoseWithCovarianceStamped,
        },
    ),
}
"""Role and possible types of topics whose type is not fixed."""
_POSE_TOPICS = {"truth": "ground_truth", "estimate": "pose"}


class RobotSource:
    """Subscribes to the topics of one robot."""

    def __init__(
        self, node: DiffbotNode[WatchConfig], name: str, namespace: str, state: LiveState, clock: PageClock
    ) -> None:
        """Subscribe. The model writes its results to ``state`` under the robot's ``name``."""
        self._node = node
        self._prefix = f"/{namespace.strip('/')}" if namespace.strip("/") else ""
        self.model = RobotModel(clock, RobotSink(state, name), self._prefix)
        self.model.set_state(silence=(WARNING, "no controller yet"))
        self._status_received: float | None = None
        self._subscribed: set[str] = set()
        controller, docking = node.config.controller, node.config.dock_controller
        for kind, topic, role, qos in (
            (PoseWithCovarianceStamped, "pose", "estimate", SENSOR),
            (PoseWithCovarianceStamped, "global_pose", "fixes", SENSOR),
            (Odometry, "ground_truth", "truth", SENSOR),
            (Path, "path", "plan", QUEUE),
            (PointCloud2, "landmarks", "landmarks", SENSOR),
            (Float64MultiArray, f"{controller}/navigation", "law", SENSOR),
            (DiagnosticStatus, f"{node.config.ekf}/status", "filter", LATCHED),
            (DiagnosticArray, f"{controller}/goal_results", "results", LATCHED),
            (DiagnosticStatus, f"{controller}/goal_feedback", "feedback", QUEUE),
            (PoseWithCovarianceStamped, "dock/pose", "dock_pose", SENSOR),
            (DiagnosticStatus, f"{docking}/status", "docking", LATCHED),
            (DiagnosticArray, f"{docking}/goal_results", "docking_results", LATCHED),
        ):
            node.subscribe(kind, self._topic(topic), partial(self.model.add, role), qos)
        node.subscribe(Odometry, self._topic("odom"), self._on_odometry, SENSOR)
        node.subscribe(DiagnosticStatus, self._topic(f"{controller}/status"), self._on_controller, LATCHED)

    def _topic(self, name: str) -> str:
        return f"{self._prefix}/{name}"

    def update(self, types: dict[str, list[str]]) -> None:
        """Subscribe to topics whose type is known by now, and check if the controller still sends its status.

        Without the check, the page would show the last status of a controller that has ended, such as ``driving``.

        Args:
            types: types of each topic in the graph, by its name.
        """
        for name, (role, kinds) in _TYPES_OF.items():
            topic = self._topic(name)
            found = [kind for kind in types.get(topic, []) if kind in kinds]
            if found and name not in self._subscribed:
                self._subscribed.add(name)
                self._node.subscribe(kinds[found[0]], topic, partial(self.model.add, role), SENSOR)
        if self._status_received is not None and time.monotonic() - self._status_received > SILENCE:
            is_there = self._node.count_publishers(self._topic(f"{self._node.config.controller}/status"))
            words = (ERROR, "no status from the controller") if is_there else (OK, "controller ended")
            self.model.set_state(silence=words)

    def _on_odometry(self, message: Any) -> None:
        # The model places the odometry at the first pose in the map, if a node publishes such poses.
        for role, name in _POSE_TOPICS.items():
            if role not in self.model.roles and self._node.count_publishers(self._topic(name)):
                self.model.roles.add(role)
        self.model.add("odometry", message)

    def _on_controller(self, message: Any) -> None:
        self._status_received = time.monotonic()
        self.model.add("controller", message)
