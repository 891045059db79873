"""The topics of one robot, as rows and texts for the page. Subscriptions with raw bytes, so that they cost little."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, TwistStamped
from geometry_msgs.msg import Twist as TwistMessage
from nav_msgs.msg import Odometry, Path
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Float64MultiArray, String

from diffbot_control.filter.covariance import uncertainty_of
from diffbot_control.law.docking_axis import DockingConfig
from diffbot_control.ros.messages.fields import planar_covariance, pose_of, stamp_ns, twist_from
from diffbot_control.ros.messages.raw import read_odometry, read_pose
from diffbot_core.cdr import CdrError
from diffbot_core.errors import BadMessageError
from diffbot_core.geometry import Pose, origin_of_frame, out_of_frame
from diffbot_core.ros.node import LATCHED, QUEUE, DiffbotNode
from diffbot_core.ros.qos import SENSOR
from diffbot_core.units import S_PER_NS
from diffbot_tools.view.bag_tables import LAW_COLUMNS
from diffbot_tools.view.events import EventMaker
from diffbot_tools.view.footprint import read_footprint
from diffbot_tools.view.goals import Change, GoalWatch
from diffbot_tools.view.landmarks import read_cloud
from diffbot_tools.view.live_dock import DockPlacer
from diffbot_tools.view.live_landmarks import LandmarkPlacer
from diffbot_tools.view.live_state import COLUMNS, LiveState
from diffbot_tools.view.plans import PlanEnd, read_plan, thinned
from diffbot_tools.view.texts import (
    Status,
    controller_state,
    docking_state,
    filter_numbers,
    filter_state,
    number,
    read_status,
    read_statuses,
)
from diffbot_tools.view.transforms import BASES, base_name
from diffbot_tools.watch.parameters import WatchConfig

MAX_GOALS = 50
"""the last ones, which a page shows"""
SILENCE = 2.0
"""[s] without a status, which comes every 0.5 s"""
_LAST_STAMP = 2.0**31
"""[s] of ROS; beyond, or NaN, it is none"""
_TWISTS = {"geometry_msgs/msg/Twist": TwistMessage, "geometry_msgs/msg/TwistStamped": TwistStamped}
_DETECTIONS = {
    "geometry_msgs/msg/PoseStamped": PoseStamped,
    "geometry_msgs/msg/PoseWithCovarianceStamped": PoseWithCovarianceStamped,
}


class SharedClock:
    """Times of the page [s], since the first stamp of any robot."""

    def __init__(self) -> None:
        """Start without a stamp."""
        self._origin: int | None = None

    def of(self, stamp: int) -> float:
        """Return the time of a stamp [ns]."""
        if self._origin is None:
            self._origin = stamp
        return (stamp - self._origin) * S_PER_NS


class RobotWatch:
    """Subscribes to the topics of one robot."""

    def __init__(
        self, node: DiffbotNode[WatchConfig], name: str, namespace: str, state: LiveState, clock: SharedClock
    ) -> None:
        """Subscribe, and put what is received into ``state`` under the robot's ``name``."""
        self._node, self._name, self._state, self._clock = node, name, state, clock
        self._prefix = f"/{namespace.strip('/')}" if namespace.strip("/") else ""
        self._events = EventMaker(self._prefix, names_goals=True)
        self._time = 0.0
        self._estimate: Pose | None = None
        self._odometry_origin: Pose | None = None
        self._goal = GoalWatch()
        self._goals = 0
        self._shown_goals: list[list[float]] = []
        self._status: dict[str, Any] = {"text": "no controller yet", "level": 1}
        self._status_received: float | None = None
        self._has_commands = self._has_detections = False
        self._plan_end = PlanEnd()
        self._landmarks = LandmarkPlacer()
        self._dock = DockPlacer()
        controller, ekf = node.config.controller, node.config.ekf
        self._raw(PoseWithCovarianceStamped, "pose", lambda data: self._on_pose(read_pose(data)))
        self._raw(PoseWithCovarianceStamped, "global_pose", lambda data: self._on_fix(read_pose(data)))
        self._raw(Odometry, "ground_truth", lambda data: self._on_truth(read_odometry(data)))
        self._raw(Odometry, "odom", lambda data: self._on_odometry(read_odometry(data)))
        self._raw(Path, "path", self._on_path, QUEUE)
        self._raw(PointCloud2, "landmarks", self._on_landmarks)
        node.subscribe(Float64MultiArray, self._topic(f"{controller}/navigation"), self._on_law, SENSOR)
        self._raw(DiagnosticStatus, f"{controller}/status", self._on_controller, LATCHED)
        self._raw(DiagnosticStatus, f"{ekf}/status", self._on_filter, LATCHED)
        self._raw(DiagnosticArray, f"{controller}/goal_results", self._on_results, LATCHED)
        self._raw(DiagnosticStatus, f"{controller}/goal_feedback", self._on_feedback, QUEUE)
        self._raw(PoseWithCovarianceStamped, "dock/pose", lambda data: self._on_dock_pose(read_pose(data)))
        self._raw(DiagnosticStatus, f"{node.config.dock_controller}/status", self._on_docking, LATCHED)
        self._raw(String, "robot_description", self._on_description, LATCHED)

    def _topic(self, name: str) -> str:
        return f"{self._prefix}/{name}"

    def _raw(self, message_type: Any, name: str, callback: Callable[[bytes], None], qos: Any = SENSOR) -> None:
        def read(data: bytes) -> None:
            try:
                callback(data)
            except CdrError as error:
                raise BadMessageError("unreadable", str(error)) from None

        self._node.subscribe(message_type, self._topic(name), read, qos, raw=True)

    def look_for_types(self, types: dict[str, list[str]]) -> None:
        """Subscribe to cmd_vel and detected_dock_pose once the graph tells their types."""
        topic = self._topic("cmd_vel")
        found = [name for name in types.get(topic, []) if name in _TWISTS]
        if found and not self._has_commands:
            self._has_commands = True
            self._node.subscribe(_TWISTS[found[0]], topic, self._on_command, SENSOR)
        topic = self._topic("detected_dock_pose")
        found = [name for name in types.get(topic, []) if name in _DETECTIONS]
        if found and not self._has_detections:
            self._has_detections = True
            self._node.subscribe(_DETECTIONS[found[0]], topic, self._on_detection, SENSOR)

    def set_docking(self, config: DockingConfig) -> None:
        """Take how the robot docks."""
        self._dock.config = config

    def look_for_silence(self) -> None:
        """Show if the controller has stopped sending its status: what is latched of a dead one may be ``driving``."""
        if self._status_received is not None and time.monotonic() - self._status_received > SILENCE:
            is_there = self._node.count_publishers(self._topic(f"{self._node.config.controller}/status"))
            text, level = ("no status from the controller", 2) if is_there else ("controller ended", 0)
            self._set_status(text=text, level=level, reason="")

    def on_diagnostics(self, statuses: list[Status]) -> None:
        """Take the diagnoses of all nodes, of which some are this robot's."""
        self._state.add_events(self._name, self._events.of_diagnostics(self._time, statuses))

    def _row(self, curve: str, *values: float) -> None:
        self._state.put_row(self._name, curve, values)

    def _on_pose(self, message: Any) -> None:
        pose, P = pose_of(message.pose.pose), message.pose.covariance
        self._time = self._clock.of(stamp_ns(message.header.stamp))
        self._estimate = pose
        covariance = (P[0], P[1], P[7], P[35]) if any(P) else (math.nan,) * 4
        self._row("estimate", self._time, *pose, *covariance)
        self._landmarks.add_pose(stamp_ns(message.header.stamp), pose)
        self._dock.add_pose(stamp_ns(message.header.stamp), pose)
        self._put_dock()
        self._put_landmarks()

    def _on_fix(self, message: Any) -> None:
        self._row("fixes", self._clock.of(stamp_ns(message.header.stamp)), *pose_of(message.pose.pose))

    def _on_truth(self, message: Any) -> None:
        twist = twist_from(message.twist.twist)
        self._row("truth", self._clock.of(stamp_ns(message.header.stamp)), *pose_of(message.pose.pose), *twist)

    def _on_odometry(self, message: Any) -> None:
        pose, twist = pose_of(message.pose.pose), twist_from(message.twist.twist)
        time = self._clock.of(stamp_ns(message.header.stamp))
        if self._odometry_origin is None and self._estimate is not None:
            # Fixed from the first estimate on, so that the two paths part as the odometry drifts.
            self._odometry_origin = origin_of_frame(pose, self._estimate)
        if self._odometry_origin is not None:
            pose = out_of_frame(pose, self._odometry_origin)
        if self._estimate is None:
            self._time = time
            if self._node.count_publishers(self._topic("pose")):
                return  # an estimate will come, which places the odometry in the map
        self._row("odometry", time, *pose, *twist)

    def _on_command(self, message: Any) -> None:
        is_stamped = isinstance(message, TwistStamped)
        time = self._clock.of(stamp_ns(message.header.stamp)) if is_stamped else self._time
        self._row("command", time, *twist_from(message.twist if is_stamped else message))

    def _on_law(self, message: Float64MultiArray) -> None:
        labels = [dimension.label for dimension in message.layout.dim]
        if len(message.data) != len(labels) or not set(LAW_COLUMNS) <= set(labels):
            raise BadMessageError("labels missing")
        named = dict(zip(labels, message.data, strict=True))
        stamp = named["stamp"]
        time = self._clock.of(round(stamp * 1e9)) if abs(stamp) <= _LAST_STAMP else self._time
        self._row("law", time, *(named[name] for name in COLUMNS["law"][1:]))
        self._add(self._events.of_region(time, named["region"]))

    def _on_description(self, data: bytes) -> None:
        self._state.put(self._name, "box", read_footprint(data))

    def _add(self, events: Any) -> None:
        self._state.add_events(self._name, events)

    def _on_path(self, data: bytes) -> None:
        self._state.put(self._name, "plan", [self._time, thinned(read_plan(data))])

    def _on_landmarks(self, data: bytes) -> None:
        self._landmarks.add_cloud(read_cloud(data))
        self._put_landmarks()

    def _put_landmarks(self) -> None:
        if (found := self._landmarks.newest()) is not None:
            stamp, points = found
            self._state.put(self._name, "landmarks", [self._clock.of(stamp), points])

    def _on_dock_pose(self, message: Any) -> None:
        uncertainty = uncertainty_of(planar_covariance(message.pose.covariance))
        self._dock.add_dock_pose(stamp_ns(message.header.stamp), pose_of(message.pose.pose), uncertainty)
        self._put_dock()

    def _on_detection(self, message: Any) -> None:
        if base_name(message.header.frame_id) not in BASES:
            return  # of a detector whose mounting only the filter knows
        inner = message.pose if isinstance(message, PoseStamped) else message.pose.pose
        self._dock.add_detection(stamp_ns(message.header.stamp), pose_of(inner))
        self._put_dock()

    def _put_dock(self) -> None:
        if (found := self._dock.newest()) is not None:
            self._state.put(self._name, "dock", found)

    def _on_docking(self, data: bytes) -> None:
        status = read_status(data)
        self._set_status(docking=docking_state(status))
        self._add(self._events.of_status(self._time, "docking", status))

    def _on_controller(self, data: bytes) -> None:
        status = read_status(data)
        self._status_received = time.monotonic()
        self._set_status(**controller_state(status))
        change, pose = self._goal.take(status), self._goal.pose
        if pose is not None and change is not Change.NONE:
            if change is Change.NEW:
                self._goals += 1
                self._add([self._events.of_goal(self._time, self._goals, pose)])
            time_sent = self._time
            if change is Change.CORRECTED and self._shown_goals:
                *self._shown_goals, (time_sent, *_) = self._shown_goals
            # A time that has jumped back is a new run.
            self._shown_goals = [one for one in self._shown_goals if one[0] < self._time][1 - MAX_GOALS :]
            self._shown_goals = [*self._shown_goals, [time_sent, *pose]]
            self._state.put(self._name, "goals", self._shown_goals)
        if self._plan_end.is_over(status.values):
            self._state.put(self._name, "plan", [self._time, []])
        self._add(self._events.of_status(self._time, "controller", status))

    def _set_status(self, **values: Any) -> None:
        self._status = self._status | values
        self._state.put(self._name, "status", self._status)

    def _on_filter(self, data: bytes) -> None:
        status = read_status(data)
        self._set_status(**filter_state(status))
        if "NIS per number" in status.values:
            self._row("filter", self._time, *filter_numbers(status.values))
        self._add(self._events.of_status(self._time, "filter", status))

    def _on_results(self, data: bytes) -> None:
        self._add(self._events.of_results(self._time, read_statuses(data)))

    def _on_feedback(self, data: bytes) -> None:
        values = read_status(data).values
        elapsed, left = (number(values.get(f"{name} [s]")) for name in ("elapsed time", "estimated time remaining"))
        self._set_status(clock=elapsed if math.isfinite(elapsed) else None, left=left if left > 0.0 else None)
