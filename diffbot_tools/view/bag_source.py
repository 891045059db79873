"""Reads a bag: passes its messages to a model of each robot, and stores the models' results as columns and lists."""

from __future__ import annotations

import math
from array import array
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from tqdm import tqdm

from diffbot_bag.bag import BagReader, Parameters, RawMessage
from diffbot_bag.info import TopicInfo, info_of
from diffbot_bag.messages import decode
from diffbot_control.law.configuration import DockingConfig, SwitchingConfig
from diffbot_control.ros.messages.fields import stamp_ns
from diffbot_core.errors import DiffbotError
from diffbot_core.kinematics import WheelGeometry
from diffbot_core.schema import build
from diffbot_core.stamps import NS_PER_S, S_PER_NS
from diffbot_tools.filter_statistics import MAX_VAR_THETA, Trajectory, errors_at, nees_of
from diffbot_tools.opened_bag import open_bag
from diffbot_tools.view.columns import COLUMNS, Array, Columns
from diffbot_tools.view.constants import recorded_config, recorded_wheels
from diffbot_tools.view.events import Event
from diffbot_tools.view.model import RobotModel
from diffbot_tools.view.results import GoalOutcome, outcomes_of
from diffbot_tools.view.track import PageClock

ODOMETRY = "nav_msgs/msg/Odometry"
POSE, POSE_STAMPED = "geometry_msgs/msg/PoseWithCovarianceStamped", "geometry_msgs/msg/PoseStamped"
STATUS, STATUSES = "diagnostic_msgs/msg/DiagnosticStatus", "diagnostic_msgs/msg/DiagnosticArray"
ROLES: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "truth": (("ground_truth",), (ODOMETRY, POSE, POSE_STAMPED)),
    "estimate": (("pose", "odometry/filtered", "amcl_pose"), (POSE, ODOMETRY)),
    "odometry": (("odom", "odometry", "wheel/odometry"), (ODOMETRY,)),
    "fixes": (("global_pose", "gps/pose"), (POSE, ODOMETRY)),
    "command": (("cmd_vel",), ("geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped")),
    "law": (("controller/navigation",), ("std_msgs/msg/Float64MultiArray",)),
    "controller": (("controller/status",), (STATUS,)),
    "filter": (("ekf/status",), (STATUS,)),
    "goals": (("goal_pose",), (POSE_STAMPED,)),
    "results": (("controller/goal_results",), (STATUSES,)),
    "feedback": (("controller/goal_feedback",), (STATUS,)),
    "plan": (("path",), ("nav_msgs/msg/Path",)),
    "landmarks": (("landmarks",), ("sensor_msgs/msg/PointCloud2",)),
    "transforms": (("tf",), ("tf2_msgs/msg/TFMessage",)),
    "dock_pose": (("dock/pose",), (POSE,)),
    "detections": (("detected_dock_pose",), (POSE_STAMPED, POSE)),
    "docking": (("dock_controller/status",), (STATUS,)),
    "docking_goals": (("dock/goal_pose",), (POSE_STAMPED,)),
    "docking_results": (("dock_controller/goal_results",), (STATUSES,)),
}
"""Topics and types of each role: names without the robot's namespace, the preferred name first."""
COMMON = {"/diagnostics": ("diagnostics", STATUSES), "/rosout": ("log", "rcl_interfaces/msg/Log")}
"""Role and type of the topics that all robots share."""
MAX_EVENTS = 10_000
"""Number of events of one kind that are kept of a robot. Later events are dropped."""
MAX_STATES, MAX_PLANS, MAX_LANDMARKS, MAX_VISITS = 5000, 200, 500, 5000
"""Largest numbers in a report: state lines, paths, landmarks, and intervals in which a landmark is in view."""
_POSES = ("truth", "estimate", "odometry", "transforms")
"""Roles with a pose of the robot. A namespace with one of them is a robot."""
_FOREIGN_CLOCK = 1.0
"""[s] If stamps and log times differ by more than this, they are times of different clocks."""
_FIRST = 200
"""Number of messages of a topic that are read to find the clock of a bag."""

Roles = dict[str, str]
"""Topic by role."""


class BagRobot:
    """One robot of a bag, and the sink that stores the results of its model."""

    def __init__(self, namespace: str, names: Roles, clock: PageClock, parameters: Parameters) -> None:
        """Start without messages.

        Args:
            namespace: such as ``/robot1``.
            names: topics of the robot.
            clock: clock of the bag.
            parameters: recorded parameters of all nodes.
        """
        self.namespace, self.names = namespace, names
        self.name = namespace.lstrip("/") or "robot"
        self.config = recorded_config(parameters.get(f"{namespace.rstrip('/')}/controller", {}))
        self.wheels: WheelGeometry | None = recorded_wheels(parameters, namespace.rstrip("/"))
        roles = ["estimate" if role == "transforms" else role for role in names]
        self.model = RobotModel(clock, self, namespace, roles)
        self.model.tolerance = self.config.tolerance.xy_goal_tolerance
        docking = parameters.get(f"{namespace.rstrip('/')}/dock_controller", {})
        given: dict[str, Any] = {
            name: docking[name] for name in ("staging_distance", "dock_backward") if name in docking
        }
        self.model.docking_config = build(DockingConfig, given)
        self.curves: dict[str, Columns] = {}
        self.all_events: list[Event] = []
        self.states: list[list[Any]] = []
        """time [s], level and text"""
        self.dock: dict[str, Any] | None = None
        """the newest dock, see RobotModel"""
        self._rows: dict[str, array[float]] = {name: array("d") for name in COLUMNS}
        self._counts: Counter[str] = Counter()
        self._plans: list[tuple[float, list[list[float]]]] = []
        self._marks, self._cloud_times = array("d"), array("d")

    def row(self, curve: str, values: Sequence[float]) -> None:
        """Append a row to a curve."""
        self._rows[curve].extend(values)

    def events(self, events: Sequence[Event]) -> None:
        """Append events, at most MAX_EVENTS of each kind."""
        for event in events:
            self._counts[event.kind] += 1
            if self._counts[event.kind] <= MAX_EVENTS:
                self.all_events.append(event)

    def put(self, name: str, value: Any) -> None:
        """Store a value, see ModelSink."""
        if name == "state" and len(self.states) < MAX_STATES:
            self.states.append(value)
        elif name == "plan" and len(self._plans) < MAX_PLANS:
            self._plans.append(value)
        elif name == "landmarks":
            time, points = value
            self._cloud_times.append(time)
            for x, y, number in points:
                self._marks.extend((number, time, x, y))
        elif name == "dock":
            self.dock = value

    def finish(self) -> None:
        """Make the curves from all rows, in the order of time."""
        self.model.finish()
        for name, names in COLUMNS.items():
            table = np.array(self._rows[name]).reshape(-1, len(names))
            if np.any(np.diff(table[:, 0]) < 0.0):
                table = table[np.argsort(table[:, 0], kind="stable")]
            if len(table):
                self.curves[name] = dict(zip(names, table.T, strict=True))
        if "estimate" in self.curves and "truth" in self.curves:
            self.curves |= _error_curve(self.curves["estimate"], self.curves["truth"])
        self.all_events.sort(key=lambda event: event.time)

    @property
    def has_pose(self) -> bool:
        """True if the bag has at least one pose of the robot."""
        return bool({"truth", "estimate", "odometry"} & set(self.curves))

    @property
    def outcomes(self) -> list[GoalOutcome]:
        """How each goal in the map ended, in the order of acceptance."""
        return outcomes_of(sorted(self.model.goals.goals, key=lambda goal: goal.time), self.curves)

    @property
    def docking_outcomes(self) -> list[GoalOutcome]:
        """How each goal in the frame of the dock ended, in the order of acceptance."""
        path = {"estimate": self.curves["docking"]} if "docking" in self.curves else {}
        return outcomes_of(sorted(self.model.dockings.goals, key=lambda goal: goal.time), path)

    @property
    def plan(self) -> Columns:
        """Time [s], x and y [m] of all points of paths. All points of a path have the same time; NaN ends a path."""
        rows = [(time, x, y) for time, points in self._plans for x, y in points or [[math.nan, math.nan]]]
        return dict(zip(("t", "x", "y"), np.array(rows).reshape(-1, 3).T, strict=True))

    def landmarks(self) -> list[list[Any]]:
        """Return a row for each landmark: number, x and y [m], and begin and end [s] of each interval in view.

        The position is the mean of the measurements. A landmark is in view until two periods after a measurement.
        """
        marks = np.array(self._marks).reshape(-1, 4)
        numbers, counts = np.unique(marks[:, 0], return_counts=True)
        shown = np.sort(numbers[np.argsort(-counts, kind="stable")[:MAX_LANDMARKS]])
        periods = np.diff(np.unique(self._cloud_times))
        pause = 2.0 * float(np.median(periods)) if len(periods) else 1.0
        parts = [marks[marks[:, 0] == number] for number in shown]
        # Bridge longer gaps until a report can hold all intervals.
        while sum(len(_visits(part[:, 1], pause)) for part in parts) > 2 * MAX_VISITS:
            pause *= 2.0
        return [[int(part[0, 0]), *part[:, 2:].mean(axis=0).tolist(), _visits(part[:, 1], pause)] for part in parts]


class BagRun(NamedTuple):
    """The contents of a bag for a report."""

    title: str
    origin: int
    """[ns] stamp at the time 0 of the page"""
    robots: list[BagRobot]
    topics: list[TopicInfo]
    messages: int
    lost: int | None
    """number of messages that the recorder lost; None if the recorder did not report it"""
    is_cut_off: bool
    """True if the bag was not closed"""
    malformed: int
    """number of messages that could not be used"""


@np.errstate(all="ignore")
def read_bag(
    path: Path,
    config: SwitchingConfig | None = None,
    is_from_goal: bool = False,
    remap: Mapping[str, str] = MappingProxyType({}),
) -> BagRun:
    """Read a bag, with a progress bar on a terminal.

    Args:
        path: folder or .mcap file.
        config: tolerances and limits to draw; None for the recorded parameters, and ``tuned`` for missing ones.
        is_from_goal: set time 0 at the first goal, if there is one, instead of at the first pose.
        remap: topic in the bag by the name of a topic in ROLES, for topics whose names differ.

    Raises:
        DiffbotError: if the bag cannot be read, has no pose of a robot, or lacks a remapped topic.
    """
    with open_bag(path) as reader:
        types = {topic.name: topic.type for topic in reader.topics.values() if topic.encoding == "cdr"}
        found = robots_in(types, remap)
        origin, offset = _clock_of(reader, types, found)
        run = _read(reader, types, found, origin, offset, config)
        starts = [goal.time for robot in run.robots for goal in robot.model.goals.goals if not goal.is_earlier]
        if is_from_goal and starts:
            run = _read(reader, types, found, origin + round(min(starts) * NS_PER_S), offset, config)
    robots = [robot for robot in run.robots if robot.has_pose]
    if not robots:
        raise DiffbotError(f"{path} has no pose of a robot: no odometry, pose or transform could be read")
    return run._replace(robots=robots)


def _read(
    reader: BagReader,
    types: Mapping[str, str],
    found: Mapping[str, Roles],
    origin: int,
    offset: int,
    config: SwitchingConfig | None,
) -> BagRun:
    clock, parameters = PageClock(origin), reader.node_parameters()
    robots = [BagRobot(namespace, names, clock, parameters) for namespace, names in found.items()]
    users: dict[str, list[tuple[str, RobotModel]]] = {}
    for robot in robots:
        if config is not None:
            robot.config, robot.model.tolerance = config, config.tolerance.xy_goal_tolerance
        for role, topic in robot.names.items():
            users.setdefault(topic, []).append((role, robot.model))
        for topic, (role, kind) in COMMON.items():
            if types.get(topic) == kind:
                users.setdefault(topic, []).append((role, robot.model))
    definitions, malformed = reader.definitions, 0

    def observe(message: RawMessage) -> None:
        nonlocal malformed
        if message.topic not in users:
            return
        received = (message.log_time - offset - origin) * S_PER_NS
        try:
            content = decode(types[message.topic], message.data, definitions.get(message.topic))
        except DiffbotError:
            malformed += len(users[message.topic])
            return
        for role, model in users[message.topic]:
            try:
                model.add(role, content, received)
            except (DiffbotError, AttributeError, TypeError, ValueError):  # the bag's definition may lack a field
                malformed += 1

    with tqdm(
        desc=reader.path.name, total=reader.message_count, unit="message", unit_scale=True, disable=None, delay=1.0
    ) as bar:
        info = info_of(reader, progress=bar.update, observe=observe)
    for robot in robots:
        robot.finish()
    title = "/".join(reader.path.resolve().parts[-2:])
    lost, is_cut_off = info.recorder_lost, bool(reader.warning)
    return BagRun(title, origin, robots, list(info.topics), info.message_count, lost, is_cut_off, malformed)


def robots_in(types: Mapping[str, str], remap: Mapping[str, str] = MappingProxyType({})) -> dict[str, Roles]:
    """Return the topics of each robot of a bag by its namespace, such as ``/robot1``.

    If no topic has a known name, each topic with a pose is a robot.

    Args:
        types: type of each topic by its name.
        remap: topic by the name of a topic in ROLES; these topics belong to the robot without a namespace.

    Raises:
        DiffbotError: if a remapped topic is missing or has another type.
    """
    found: dict[str, Roles] = {}
    remapped = {name: "/" + topic.lstrip("/") for name, topic in remap.items()}
    for role, (names, role_types) in ROLES.items():
        for name in names:
            if (given := remapped.get(name)) is not None:
                if types.get(given) not in role_types:
                    kind = f"has the type {types[given]}" if given in types else "is not in the bag"
                    raise DiffbotError(f"--remap: {given} {kind}; {name} must be {' or '.join(role_types)}")
                found.setdefault("", {})[role] = given
            for topic, type_name in types.items():
                if type_name in role_types and topic.endswith(f"/{name}") and topic not in remapped.values():
                    found.setdefault(topic[: -len(name) - 1], {}).setdefault(role, topic)
    # A bag with /odom and /odometry/filtered has one robot: /odometry is not a namespace.
    for space in sorted(found, key=len, reverse=True):
        parent, _, last = space.rpartition("/")
        if last in ("odometry", "wheel", "gps", "dock") and parent in found:
            del found[space]
    robots = {space: roles for space, roles in sorted(found.items()) if set(_POSES) & set(roles)}
    for roles in robots.values():
        if "estimate" in roles:
            roles.pop("transforms", None)
    role_of = {ODOMETRY: "odometry", POSE: "estimate", POSE_STAMPED: "truth"}
    return robots or {topic: {role_of[kind]: topic} for topic, kind in sorted(types.items()) if kind in role_of}


def _clock_of(reader: BagReader, types: Mapping[str, str], found: Mapping[str, Roles]) -> tuple[int, int]:
    """Return the first stamp [ns] of a pose, and the log time minus the stamp [ns]; 0 if both are of one clock."""
    topics = [roles[role] for role in _POSES for roles in found.values() if role in roles]
    first: list[int] = []
    offset = 0
    for topic in topics:
        pairs = []
        for count, message in enumerate(reader.messages([topic])):
            if count == _FIRST:
                break
            try:
                content = decode(types[topic], message.data, reader.definitions.get(topic))
                header = content.transforms[0].header if hasattr(content, "transforms") else content.header
                pairs.append((stamp_ns(header.stamp), message.log_time))
            except (DiffbotError, IndexError):
                continue
        if pairs and not first:
            offset = int(np.median([log_time - stamp for stamp, log_time in pairs]))
        first += [min(stamp for stamp, _ in pairs)] if pairs else []
    is_foreign = abs(offset) * S_PER_NS > _FOREIGN_CLOCK
    return min(first, default=0), offset if is_foreign else 0


def _error_curve(estimate: Columns, truth: Columns) -> dict[str, Columns]:
    """Return the curve ``error``: estimate minus truth, three standard deviations, NEES. Return {} without a truth."""
    times, first = np.unique(truth["t"], return_index=True)
    if len(times) < 2:
        return {}
    poses = np.column_stack([truth[name][first] for name in ("x", "y", "theta")])
    poses[:, 2] = np.unwrap(poses[:, 2])
    poses[truth["tt"][first] > MAX_VAR_THETA, 2] = np.nan
    estimates = np.column_stack([estimate[name] for name in ("x", "y", "theta")])
    P = np.column_stack([estimate[name] for name in ("xx", "xy", "xt", "xy", "yy", "yt", "xt", "yt", "tt")])
    stamps, path = (np.round(t * NS_PER_S).astype(np.int64) for t in (estimate["t"], times))
    try:
        found = errors_at(stamps, estimates, P.reshape(-1, 3, 3), Trajectory(path, poses))
    except DiffbotError:
        return {}
    sigmas = np.sqrt(np.diagonal(found.P, axis1=1, axis2=2))
    nees = np.full(len(found.time), np.nan)
    regular = np.isfinite(np.column_stack((found.error, sigmas))).all(axis=1)
    regular[regular] &= np.linalg.det(found.P[regular]) > 0.0
    if regular.any():
        nees[regular] = nees_of(found.error[regular], found.P[regular])
    columns = {"t": found.time + estimate["t"][0], **dict(zip(("x", "y", "theta"), found.error.T, strict=True))}
    names = ("three_sigma_x", "three_sigma_y", "three_sigma_theta")
    return {"error": columns | {name: 3.0 * one for name, one in zip(names, sigmas.T, strict=True)} | {"nees": nees}}


def _visits(times: Array, pause: float) -> list[float]:
    """Return begin and end [s] of each interval in which a landmark is in view, in a flat list.

    A new interval begins after a gap longer than ``pause`` [s] between the ``times`` [s] of measurements. An interval
    ends ``pause`` after its last measurement.
    """
    times = np.sort(times)
    gaps = np.flatnonzero(np.diff(times) > pause)
    begins, ends = times[np.r_[0, gaps + 1]], times[np.r_[gaps, len(times) - 1]] + pause
    visits: list[float] = np.round(np.column_stack((begins, ends)).ravel(), 3).tolist()
    return visits
