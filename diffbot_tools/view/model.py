"""Translates the messages of one robot into rows of curves, events, goals and texts for the page.

The same model serves a bag (view/bag_source.py) and a running robot (watch/ros_source.py). It keeps only the newest
values, and passes its results to a sink, which stores them.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple, Protocol

import numpy as np

from diffbot_control.filter.covariance import uncertainty_of
from diffbot_control.filter.models import UNKNOWN_HEADING
from diffbot_control.law.configuration import DockingConfig
from diffbot_control.law.docking_axis import APPROACH_LENGTH, CORRIDOR, MAX_UNCERTAINTY
from diffbot_control.ros.messages.fields import planar_covariance, pose_of, stamp_ns, twist_from
from diffbot_control.ros.messages.landmark_cloud import landmark_points
from diffbot_core.errors import BadMessageError
from diffbot_core.geometry import MAX_COORDINATE, Pose, into_frame, origin_of_frame, out_of_frame, wrap_angle
from diffbot_core.kinematics import Twist
from diffbot_tools.view.events import Event, EventMaker, docking_verb, end_event, goal_event
from diffbot_tools.view.goal_list import Goal, GoalList
from diffbot_tools.view.texts import filter_numbers, number, status_of, statuses_of
from diffbot_tools.view.track import BASES, PageClock, Stamped, Track, TransformTree, base_name
from diffbot_tools.view.words import RobotSituation, docking_words, state_words

LAW_LABELS = ("stamp", "rho", "alpha", "beta", "eps_P", "region", "V")
"""Labels of controller/navigation that the page needs."""
MAX_POINTS = 500
"""Number of points of a path that are drawn."""
SHOWN_GOALS = 50
"""Number of newest goals that a live page shows."""
_COVARIANCE = np.array([0, 1, 7, 35, 5, 11])
"""Indices of xx, xy, yy, tt, xt and yt (t is theta) in the covariance of a pose message."""
_NO_COVARIANCE = np.zeros(36)
_UNKNOWN_COVARIANCE = (math.nan,) * len(_COVARIANCE)
_LAST_STAMP = 2.0**31
"""[s] Largest stamp of ROS. A larger number is not a stamp."""
_STATE_PERIOD = 0.5
"""[s] Shortest time between two updates of the state line for new distances."""
_MAX_DELAY = 60.0
"""[s] Largest delay of a recorder. A stamp that differs more from the time of reception is of another clock."""
_MAX_WAITING = 100
"""Number of fixes, clouds and detections that wait for the pose at their stamp."""
_MAX_HELD = 2000
"""Number of odometry messages that wait for the first pose in the map."""


class ModelSink(Protocol):
    """Receives the results of a model."""

    def row(self, curve: str, values: Sequence[float]) -> None:
        """Add a row to a curve, in the order of columns.COLUMNS."""

    def events(self, events: Sequence[Event]) -> None:
        """Add new events."""

    def put(self, name: str, value: Any) -> None:
        """Set ``state``, ``goals``, ``plan``, ``landmarks`` or ``dock`` to a value for JSON."""


class _Waiting(NamedTuple):
    """A measurement that waits for the pose of the robot at its stamp [ns]."""

    stamp: int
    place: Callable[[Pose], None]
    """called with the pose"""


class RobotModel:
    """Translates the messages of one robot."""

    def __init__(self, clock: PageClock, sink: ModelSink, namespace: str = "", roles: Sequence[str] = ()) -> None:
        """Start without messages.

        Args:
            clock: clock of the page, which all its robots share.
            sink: receives the results.
            namespace: such as ``/robot1``.
            roles: roles of the topics that exist, see bag_source.ROLES. A missing role is added with its first message.
        """
        self.time, self.roles = 0.0, set(roles)
        self.goals, self.dockings = GoalList(), GoalList()
        """goals in the map, and goals in the frame of the dock"""
        self.tolerance, self.docking_config = 0.1, DockingConfig()
        self._clock, self._sink = clock, sink
        self._events = EventMaker(namespace)
        self._now = 0.0
        self._track, self._transforms = Track(), TransformTree()
        self._waiting: deque[_Waiting] = deque(maxlen=_MAX_WAITING)
        self._held: deque[tuple[Stamped, Twist]] = deque(maxlen=_MAX_HELD)
        self._reference: Stamped | None = None
        self._odometry_frame: Pose | None = None
        self._situation = RobotSituation()
        self._words: tuple[int, str] = (0, "")
        self._words_time = -math.inf
        self._law_labels: list[str] = []
        self._law_places: list[int] = []
        """indices of LAW_LABELS in the labels of the newest message"""
        self._dock: Pose | None = None
        self._detections: deque[Pose] = deque(maxlen=20)
        self._handlers = self._make_handlers()
        self._role = ""

    def _make_handlers(self) -> dict[str, Callable[[Any], None]]:
        """Return the method that processes the messages of each role."""
        return {
            **{role: self._on_map_pose for role in ("estimate", "truth")},
            "odometry": self._on_odometry,
            "fixes": self._on_fix,
            "command": self._on_command,
            "law": self._on_law,
            "controller": self._on_controller,
            "filter": self._on_filter,
            "goals": partial(self._on_goal_pose, goals=self.goals),
            "results": partial(self._on_results, goals=self.goals),
            "feedback": self._on_feedback,
            "plan": self._on_plan,
            "landmarks": self._on_landmarks,
            "transforms": self._on_transforms,
            "dock_pose": self._on_dock_pose,
            "detections": self._on_detection,
            "docking": self._on_docking,
            "docking_goals": partial(self._on_goal_pose, goals=self.dockings),
            "docking_results": partial(self._on_results, goals=self.dockings),
            "diagnostics": lambda message: self._add(self._events.of_diagnostics(self._now, statuses_of(message))),
            "log": lambda one: self._add(self._events.of_log(self._now, one.level, one.name, one.msg)),
        }

    @property
    def main(self) -> str:
        """Role of the best available pose of the robot."""
        return "estimate" if "estimate" in self.roles else "truth" if "truth" in self.roles else "odometry"

    def add(self, role: str, message: Any, received: float | None = None) -> None:
        """Process a message: any object with the attributes of its ROS type.

        Args:
            role: role of its topic, see bag_source.ROLES.
            message: has a type of this role.
            received: [s] time of reception, for messages without a stamp; None for the time of the newest pose.

        Raises:
            BadMessageError: if the message cannot be used.
        """
        self.roles.add("estimate" if role == "transforms" else role)
        self._role, self._now = role, self.time if received is None else received
        if received is not None and role in ("odometry", "fixes"):
            stamp = self._clock.of(stamp_ns(message.header.stamp))
            self._add(self._events.of_stamp(role, stamp, received))
        self._handlers[role](message)

    def finish(self) -> None:
        """Process the end of a bag: if it has no pose in the map, place the odometry in its own frame."""
        if self._odometry_frame is None:
            self._place_odometry(Pose(0.0, 0.0, 0.0))

    def set_state(self, **values: Any) -> None:
        """Change fields of the situation (words.RobotSituation), which determines the state line."""
        self._situation = self._situation._replace(**values)
        self._put_state()

    def _add(self, events: Sequence[Event]) -> None:
        if events:
            self._sink.events(events)

    def _row(self, curve: str, *values: float) -> None:
        self._sink.row(curve, values)

    # Poses

    def _on_map_pose(self, message: Any) -> None:
        stamp, pose = _stamped_pose(message)
        covariance = np.asarray(getattr(message.pose, "covariance", _NO_COVARIANCE), float)
        time = self._clock.of(stamp)
        if self._role == "estimate":
            known = covariance[_COVARIANCE].tolist() if covariance.any() else _UNKNOWN_COVARIANCE
            self._row("estimate", time, *pose, *known)
        else:
            twist = twist_from(message.twist.twist) if hasattr(message, "twist") else Twist(math.nan, math.nan)
            self._row("truth", time, *pose, *twist, float(covariance[35]))
        self._on_pose(self._role, stamp, pose)

    def _on_transforms(self, message: Any) -> None:
        for stamp, pose in self._transforms.add(message):
            self._row("estimate", self._clock.of(stamp), *pose, *_UNKNOWN_COVARIANCE)
            self._on_pose("estimate", stamp, pose)

    def _on_pose(self, role: str, stamp: int, pose: Pose) -> None:
        """Process a pose in the map."""
        if self._odometry_frame is None and role == ("truth" if "truth" in self.roles else "estimate"):
            if self._reference is None or not self._held:
                self._reference = Stamped(stamp, pose)
            self._align_odometry()
        if role == self.main:
            self._on_main_pose(stamp, pose)

    def _on_main_pose(self, stamp: int, pose: Pose) -> None:
        self.time = time = self._clock.of(stamp)
        if self._track.add(stamp, pose):
            self._waiting.clear()
            self._detections.clear()
            self._dock = None
        goal = self.goals.newest
        local = into_frame(pose, goal.pose) if goal else Pose(math.nan, math.nan, math.nan)
        self._row("to_goal", time, math.hypot(local.x, local.y), local.theta)
        self._situation = self._situation._replace(to_go=local)
        ready = [one for one in self._waiting if one.stamp <= stamp]
        if ready:
            self._waiting = deque((one for one in self._waiting if one.stamp > stamp), _MAX_WAITING)
        for one in ready:
            if (placed := self._track.at(one.stamp)) is not None:
                one.place(placed)
        if not 0.0 <= time - self._words_time < _STATE_PERIOD:
            self._put_state()

    def _wait(self, stamp: int, place: Callable[[Pose], None]) -> None:
        """Call ``place`` with the pose of the robot at a stamp [ns], now or as soon as the pose is known."""
        if stamp > self._track.end:
            self._waiting.append(_Waiting(stamp, place))
        elif (pose := self._track.at(stamp)) is not None:
            place(pose)

    def _on_odometry(self, message: Any) -> None:
        stamp, pose = _stamped_pose(message)
        twist = twist_from(message.twist.twist)
        self._situation = self._situation._replace(speed=twist)
        self._held.append((Stamped(stamp, pose), twist))
        if not {"truth", "estimate"} & self.roles:
            self._odometry_frame = Pose(0.0, 0.0, 0.0)
        if self._odometry_frame is None:
            self._align_odometry()
        else:
            self._place_odometry(self._odometry_frame)

    def _align_odometry(self) -> None:
        """Place the odometry so that its path and the path in the map begin at the same pose.

        The first pose in the map after the start of the odometry is used: the true pose if there is one, else the
        estimate. After this pose, the two paths differ by the drift of the odometry.
        """
        if self._reference is not None and self._held and self._reference.stamp < self._held[0][0].stamp:
            self._reference = None
        if self._reference is None or not self._held or self._held[-1][0].stamp < self._reference.stamp:
            return
        first = next(one for one, _ in self._held if one.stamp >= self._reference.stamp)
        self._place_odometry(origin_of_frame(first.pose, self._reference.pose))

    def _place_odometry(self, frame: Pose) -> None:
        self._odometry_frame = frame
        while self._held:
            (stamp, pose), twist = self._held.popleft()
            placed = out_of_frame(pose, frame)
            self._row("odometry", self._clock.of(stamp), *placed, *twist)
            if self.main == "odometry":
                self._on_main_pose(stamp, placed)

    def _on_fix(self, message: Any) -> None:
        stamp, fix = _stamped_pose(message)
        if message.pose.covariance[35] >= UNKNOWN_HEADING:
            fix = fix._replace(theta=math.nan)
        time = self._clock.of(stamp)
        self._row("fixes", time, *fix)

        def compare(pose: Pose) -> None:
            self._row("residual", time, fix.x - pose.x, fix.y - pose.y, wrap_angle(fix.theta - pose.theta))

        if self.main == "estimate":
            self._wait(stamp, compare)

    # Controller, filter and law

    def _on_command(self, message: Any) -> None:
        is_stamped = hasattr(message, "twist")
        time = self._clock.of(stamp_ns(message.header.stamp)) if is_stamped else self._now
        self._row("command", time, *twist_from(message.twist if is_stamped else message))

    def _on_law(self, message: Any) -> None:
        labels = [dimension.label for dimension in message.layout.dim]
        if labels != self._law_labels:
            if not set(LAW_LABELS) <= set(labels):
                raise BadMessageError("labels missing")
            self._law_labels, self._law_places = labels, [labels.index(name) for name in LAW_LABELS]
        if len(message.data) != len(labels):
            raise BadMessageError("number of values differs from number of labels")
        stamp, rho, alpha, beta, *rest = (float(message.data[place]) for place in self._law_places)
        time = self._clock.of(round(stamp * 1e9)) if abs(stamp) <= _LAST_STAMP else self._now
        if rho < self.tolerance:
            alpha = beta = math.nan  # at the goal, the angles are not defined
        self._row("law", time, rho, alpha, beta, *rest)
        self._add(self._events.of_region(time, rest[1]))

    def _on_controller(self, message: Any) -> None:
        status = status_of(message)
        was_on_path = "waypoint" in self._situation.controller.values
        self._add_goal(self.goals.add_status(self._now, status), self.goals)
        if was_on_path and "waypoint" not in status.values:
            self._sink.put("plan", [self._now, []])
        is_driving = status.message == "driving"
        self.set_state(controller=status, silence=None, **({"docking": None} if is_driving else {}))
        self._put_goals()
        self._add(self._events.of_status(self._now, status))

    def _on_goal_pose(self, message: Any, goals: GoalList) -> None:
        header = message.header
        stamp = stamp_ns(header.stamp)
        self._add_goal(goals.add_request(self._now, header.frame_id, stamp, pose_of(message.pose)), goals)

    def _add_goal(self, goal: Goal | None, goals: GoalList) -> None:
        if goal is not None:
            self._add([goal_event(goal, goals.count, is_docking=goals is self.dockings)])
            self._put_goals()

    def _on_results(self, message: Any, goals: GoalList) -> None:
        # The stamp is the time of the newest answer. A recorder that is held up receives the message later.
        # The stamp must not become time 0 of a live page, since the first message is latched and can be old.
        stamp = stamp_ns(message.header.stamp)
        is_exact = self._clock.origin is not None and abs(self._clock.of(stamp) - self._now) <= _MAX_DELAY
        time = self._clock.of(stamp) if is_exact else self._now
        is_docking = goals is self.dockings
        for one in goals.add_results(time, statuses_of(message), is_exact=is_exact):
            if isinstance(one, Goal):
                subject = f"{docking_verb(one.pose)}:" if is_docking else "goal"
                event = end_event(time, one.end, one.reason, one.source, subject)
            else:
                reason, source = (one.values.get(key, "") for key in ("reason", "source"))
                event = end_event(time, one.message, reason, source, "docking:" if is_docking else "goal")
            self._add([event])
        self._put_goals()

    def _put_goals(self) -> None:
        """Pass the newest goals in the map to the sink, without goals from before a jump back in time."""
        rows = [
            [one.time, *one.pose, None if math.isnan(one.ended) else one.ended]
            for one in self.goals.goals[-SHOWN_GOALS:]
            if one.time <= self._now
        ]
        self._sink.put("goals", rows)

    def _on_filter(self, message: Any) -> None:
        status = status_of(message)
        self.set_state(filter=status.values.get("reason", status.message) if status.level else "")
        if "NIS per number" in status.values:
            self._row("filter", self._now, *filter_numbers(status.values))
        self._add(self._events.of_status(self._now, status))

    def _on_feedback(self, message: Any) -> None:
        self._situation = self._situation._replace(
            left=number(status_of(message).values.get("estimated time remaining [s]"))
        )

    def _put_state(self) -> None:
        words = state_words(self._situation, self.tolerance)
        self._words_time = self.time
        if words != self._words:
            self._words = words
            self._sink.put("state", [self.time, *words])

    # Path, landmarks, dock

    def _on_plan(self, message: Any) -> None:
        points = _points_of(message)
        step = max(1, math.ceil(len(points) / MAX_POINTS))
        kept = points[::step] + (points[-1:] if (len(points) - 1) % step else [])
        self._sink.put("plan", [self._now, kept])

    def _on_landmarks(self, message: Any) -> None:
        _check_base(message.header.frame_id)
        points = [
            (one.number, one.range * math.cos(one.bearing), one.range * math.sin(one.bearing))
            for one in landmark_points(message)
            if math.isfinite(one.var_range + one.var_bearing)
        ]
        stamp = stamp_ns(message.header.stamp)

        def place(robot: Pose) -> None:
            placed = [(*out_of_frame(Pose(x, y, 0.0), robot)[:2], number) for number, x, y in points]
            self._sink.put("landmarks", [self._clock.of(stamp), [list(one) for one in placed]])

        self._wait(stamp, place)

    def _on_dock_pose(self, message: Any) -> None:
        stamp, in_dock = _stamped_pose(message)
        is_known = uncertainty_of(planar_covariance(message.pose.covariance)).xy <= MAX_UNCERTAINTY

        if is_known:
            self._row("docking", self._clock.of(stamp), *in_dock)

        def place(robot: Pose) -> None:
            self._dock = origin_of_frame(in_dock, robot) if is_known else None
            self._put_dock()

        self._wait(stamp, place)

    def _on_detection(self, message: Any) -> None:
        if base_name(message.header.frame_id) not in BASES:
            return  # only the filter knows where this detector is mounted
        stamp, docked = _stamped_pose(message)

        def place(robot: Pose) -> None:
            self._detections.append(out_of_frame(docked, robot))
            self._put_dock()

        self._wait(stamp, place)

    def _put_dock(self) -> None:
        self._sink.put(
            "dock",
            {
                "pose": self._dock and list(self._dock),
                "detections": [[one.x, one.y] for one in self._detections],
                "staging": self.docking_config.staging_distance,
                "halfWidth": CORRIDOR * APPROACH_LENGTH,
                "isBackward": self.docking_config.dock_backward,
            },
        )

    def _on_docking(self, message: Any) -> None:
        status = status_of(message)
        self._add_goal(self.dockings.add_status(self._now, status), self.dockings)
        self.set_state(docking=docking_words(status, self._situation.docking))
        self._add(self._events.of_status(self._now, status))


def _stamped_pose(message: Any) -> tuple[int, Pose]:
    """Return stamp [ns] and pose of a PoseStamped, a PoseWithCovarianceStamped or an Odometry."""
    return stamp_ns(message.header.stamp), pose_of(getattr(message.pose, "pose", message.pose))


def _points_of(message: Any) -> list[list[float]]:
    """Return the points [m] of a nav_msgs/Path without the poses whose position is not usable."""
    points = []
    for one in message.poses:
        if base_name(one.header.frame_id or message.header.frame_id) in (*BASES, "odom"):
            raise BadMessageError("path not in the map")
        x, y = one.pose.position.x, one.pose.position.y
        if math.isfinite(x + y) and max(abs(x), abs(y)) <= MAX_COORDINATE:
            points.append([x, y])
    return points


def _check_base(frame: str) -> None:
    if base_name(frame) not in BASES:
        raise BadMessageError("cloud not in the frame of the robot", frame[:40])
