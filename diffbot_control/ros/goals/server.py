"""The goal server of the controller: it receives goals, accepts or refuses them, and reports progress and results."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from typing import TYPE_CHECKING, Any, NamedTuple

from action_msgs.srv import CancelGoal
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path
from rclpy.node import NodeNameNonExistentError
from std_srvs.srv import Trigger

from diffbot_control.goals import states
from diffbot_control.goals.path_headings import with_headings
from diffbot_control.goals.record import CANCELLED, REFUSED, REPLACED, GoalRecord, GoalRequest, goal_id
from diffbot_control.goals.timing import time_remaining
from diffbot_control.ros.controller_publishers import goal_info
from diffbot_control.ros.messages.conversions import path_from, read_path
from diffbot_control.ros.messages.fields import stamp_ns
from diffbot_control.ros.tf import transforms_of
from diffbot_control.ros.transforms import Transforms, pose_in_frame
from diffbot_core.errors import BadMessageError
from diffbot_core.geometry import Pose
from diffbot_core.ros.qos import sensor_qos
from diffbot_core.stamps import NS_PER_S, S_PER_NS, StampWatch

if TYPE_CHECKING:
    from diffbot_control.controller_node import ControllerNode

GOAL_TOPIC, PATH_TOPIC, UPDATE_TOPIC = "goal_pose", "path", "goal_update"
REPEATED, WITHOUT_GOAL = "goals that are known already", f"{UPDATE_TOPIC} without a goal"
"""Counters in /diagnostics. Both are normal: a client repeats a goal until the controller reports it."""
FEEDBACK_PERIOD = 0.2
"""[s] between two messages of feedback"""
_PERIOD, _BURST = 0.05, 10
"""[s] smallest time between two goals by topic, and number of goals that are accepted at once after a pause. In a flood
of goals the newest one is accepted, and the node still answers poses."""
_UPDATE_TIMEOUT = 1.0
"""[s] largest age of a goal_update"""


class GoalFeedback(NamedTuple):
    """Progress towards the current goal."""

    id: str
    state: str
    """states.DRIVING or states.CANCELLING"""
    pose: Pose
    distance: float
    """[m] remaining distance along straight lines"""
    elapsed: float
    """[s] since the goal was accepted"""
    remaining: float
    """[s] estimated time until the goal is reached"""
    poses: int
    """number of goals of the path that remain"""


class _GoalTransforms:
    """Looks up transforms for goals: the newest transform if the stamp is ahead of the controller's time.

    Clients stamp goals with the system clock even if time is simulated, because the stamp identifies the goal.
    """

    def __init__(self, transforms: Transforms, now: float) -> None:
        """Store the transforms, and the controller's time [s]."""
        self.available, self._transforms = transforms.available, transforms
        self._now = round(now * NS_PER_S)

    def lookup(self, target: str, source: str, stamp: int) -> Any:
        """Return a transform as :meth:`Transforms.lookup` does."""
        return self._transforms.lookup(target, source, stamp if stamp <= self._now else 0)


class GoalServer:
    """Receives goals, corrections and cancellations, and passes them to the supervisor of the node."""

    def __init__(self, node: ControllerNode) -> None:
        """Create subscriptions, services and the timer of the feedback."""
        self._node = node
        self.on_end: list[Callable[[GoalRecord], None]] = []
        """functions to call once with the record of each goal that has ended"""
        self.on_feedback: list[Callable[[GoalFeedback], None]] = []
        """functions to call every FEEDBACK_PERIOD while the robot drives to a goal"""
        self._transforms = transforms_of(node, node.config.transform_tolerance)
        self._waiting: tuple[Any, GoalRequest] | None = None
        """newest goal by topic, until it is accepted or refused"""
        self._busy_until, self._newest_stamp = 0.0, 0
        """[s] steady time up to which the accepted goals use up their rate of one per _PERIOD; [ns] newest stamp that
        was given to a goal without a stamp"""
        self._first_distance = 0.0
        """[m] largest remaining distance of the current goal"""
        self._update_stamps = StampWatch()
        node.subscribe(PoseStamped, GOAL_TOPIC, lambda message: self._receive(message, GOAL_TOPIC))
        node.subscribe(Path, PATH_TOPIC, lambda data: self._receive(read_path(data), PATH_TOPIC), raw=True)
        node.subscribe(PoseStamped, UPDATE_TOPIC, self._on_update, sensor_qos(node.config.reliable_inputs))
        node.create_service(Trigger, "~/cancel", self._on_cancel)
        node.create_service(CancelGoal, "~/cancel_goal", self._on_cancel_goal)
        node.create_timer(FEEDBACK_PERIOD, self._publish_feedback, clock=node.steady_clock)

    def _receive(self, message: Any, topic: str) -> None:
        """Accept a goal or a path by topic, or store it if many goals have just arrived."""
        header = message.header
        stamp, now = stamp_ns(header.stamp), self._node.clock_watch.now()
        if not stamp:
            # Two goals without a stamp are different goals, even if a simulated clock stands still.
            stamp = self._newest_stamp = max(round(now * NS_PER_S), self._newest_stamp + 1)
        request = GoalRequest(goal_id(header.frame_id, stamp), topic, now)
        is_waiting = self._waiting is not None and self._waiting[1].id == request.id
        if is_waiting or self._node.supervisor.goals.knows(request.id):
            self._node.health.counted[REPEATED] += 1
            return
        self.drop_waiting(REPLACED, f"by a newer goal ({topic})")
        self._waiting = message, request
        # Refuse goals of an inactive node at once: the node would accept a waiting goal after its activation.
        if not (self._node.is_active and self._is_busy()):
            self._take()

    def _is_busy(self) -> bool:
        return self._busy_until - time.monotonic() > (_BURST - 1) * _PERIOD

    def take_waiting(self) -> None:
        """Accept or refuse the waiting goal, if there is one and the rate of goals allows it."""
        if self._waiting is None or self._is_busy():
            return
        topic = self._waiting[1].source
        try:
            self._take()
        except BadMessageError as error:
            self._node.contain(error, topic)

    def drop_waiting(self, end: str, reason: str) -> bool:
        """End the waiting goal without accepting it; return True if there was a waiting goal."""
        waiting, self._waiting = self._waiting, None
        if waiting is not None:
            self._node.supervisor.goals.refuse(waiting[1], end, reason)
        return waiting is not None

    def _take(self) -> None:
        """Accept the waiting goal or refuse it.

        Raises:
            BadMessageError: if the goal is refused; the text is the reason.
        """
        if self._waiting is None:
            return
        self._busy_until = max(self._busy_until, time.monotonic()) + _PERIOD
        (message, request), self._waiting = self._waiting, None
        try:
            goals = self.goals_of(message)
        except BadMessageError as error:
            self._node.supervisor.goals.refuse(request, REFUSED, str(error))
            self.publish_changes()
            raise
        self._accept(goals, message, request)

    def goals_of(self, message: Any) -> list[Pose]:
        """Return the poses of a PoseStamped or a Path in ``map_frame``.

        Raises:
            BadMessageError: if the message cannot be used, or the node is inactive.
        """
        if not self._node.is_active:
            raise BadMessageError("the controller is inactive")
        frame, transforms = self._node.config.map_frame, _GoalTransforms(self._transforms, self._node.clock_watch.now())
        if hasattr(message, "poses"):
            return path_from(message, frame, transforms)
        return [pose_in_frame(message.pose, message.header, frame, transforms)]

    def accept(self, message: PoseStamped | Path, source: str, goal_id: str) -> None:
        """Accept a goal or a path of an action at once.

        Raises:
            BadMessageError: if the message cannot be used; the current goal does not change.
        """
        goals = self.goals_of(message)
        self.drop_waiting(REPLACED, f"by a newer goal ({source})")
        self._accept(goals, message, GoalRequest(goal_id, source, self._node.clock_watch.now()))

    def _accept(self, goals: list[Pose], message: Any, request: GoalRequest) -> None:
        supervisor = self._node.supervisor
        supervisor.pass_time(self._node.clock_watch.now(), time.monotonic())
        if hasattr(message, "poses"):
            path = goals
            if supervisor.config.waypoint_radius > 0.0:  # otherwise the robot reaches each pose with its given heading
                path = with_headings(goals, all(one.pose.orientation.w == 1.0 for one in message.poses[1:-1]))
            supervisor.on_path(path, request)
            text = f"path of {len(goals)} goals"
            if path is not goals:
                text += ": its orientations are equal and contradict its direction, so the direction replaces them"
        else:
            supervisor.on_goal(goals[0], request)
            text = "goal: x {:.3f} m, y {:.3f} m, heading {:.3f} rad".format(*goals[0])
        self._first_distance = 0.0
        self._node.get_logger().info(text)
        self._node.outputs.publish_status(supervisor)
        self.publish_changes(force=True)

    def _on_update(self, message: PoseStamped) -> None:
        """Correct the current goal.

        Raises:
            BadMessageError: if the correction is far from the goal, or if its stamp is old or does not advance, because
                its sender may no longer detect the goal.
        """
        node = self._node
        if node.supervisor.goals.present is None:
            node.health.counted[WITHOUT_GOAL] += 1
            return
        goal = pose_in_frame(message.pose, message.header, node.config.map_frame, self._transforms)
        if stamp := stamp_ns(message.header.stamp):
            age = node.clock_watch.now() - stamp * S_PER_NS
            if age > _UPDATE_TIMEOUT:
                raise BadMessageError("stamp too old", f"{age:.3g} s, at most {_UPDATE_TIMEOUT:g} s")
            if not self._update_stamps.advances(stamp):
                raise BadMessageError("stamp not later than the previous stamp")
        node.supervisor.on_goal_update(goal)

    def cancel(self, reason: str) -> bool:
        """Drop the goal and start to brake; return True if there was a goal.

        Args:
            reason: who cancels the goal, such as ``by a call of /controller/cancel``.
        """
        node, supervisor = self._node, self._node.supervisor
        had_goal = self.drop_waiting(CANCELLED, reason) or supervisor.goal is not None
        if had_goal:
            node.get_logger().info(f"goal cancelled {reason}")
        command = supervisor.on_cancel(reason)
        if command is not None:
            node.outputs.commands.send(command)
        node.outputs.publish_status(supervisor)
        self.publish_changes(force=had_goal)
        return had_goal

    def cancel_goal(self, goal_id: str, reason: str) -> bool:
        """Cancel the current goal if its id is ``goal_id``; return True if it is cancelled."""
        present = self._node.supervisor.goals.present
        return present is not None and present.request.id == goal_id and (present.is_cancelling or self.cancel(reason))

    def _caller_of(self, service: str) -> str:
        """Return who may have called a service of this node: all its clients, as a request does not name its sender."""
        node, clients = self._node, set[str]()
        service = node.resolve_service_name(service)
        for name, namespace in node.get_node_names_and_namespaces():
            with suppress(NodeNameNonExistentError):  # the node has just left the graph
                if service in dict(node.get_client_names_and_types_by_node(name, namespace)):
                    clients.add(f"{namespace.rstrip('/')}/{name}")
        # A call may arrive before the middleware knows to which node its client belongs.
        if node.count_clients(service) > len(clients):
            clients.add("an unknown node")
        return f"by a call of {service}" + (f" from {' or '.join(sorted(clients))}" if clients else "")

    def _on_cancel(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success = self.cancel(self._caller_of("~/cancel"))
        response.message = "cancelled" if response.success else "there was no goal"
        return response

    def _on_cancel_goal(self, request: CancelGoal.Request, response: CancelGoal.Response) -> CancelGoal.Response:
        """Cancel one goal, or all goals accepted up to a time, as action_msgs/srv/CancelGoal defines."""
        self.take_waiting()
        book, goal_id = self._node.supervisor.goals, bytes(request.goal_info.goal_id.uuid).hex()
        is_named, until = bool(goal_id.strip("0")), request.goal_info.stamp
        has_time = bool(until.sec or until.nanosec)
        if is_named and not has_time and not book.knows(goal_id):
            response.return_code = CancelGoal.Response.ERROR_UNKNOWN_GOAL_ID
            return response
        present = book.present
        is_requested = present is not None and (
            present.request.id == goal_id
            or (has_time and round(present.request.time * NS_PER_S) <= until.sec * NS_PER_S + until.nanosec)
            or not (is_named or has_time)
        )
        if present is not None and is_requested:
            self.cancel_goal(present.request.id, self._caller_of("~/cancel_goal"))
            response.goals_canceling = [goal_info(present)]
        elif is_named:
            response.return_code = CancelGoal.Response.ERROR_GOAL_TERMINATED
        else:
            response.return_code = CancelGoal.Response.ERROR_REJECTED
        return response

    def publish_changes(self, force: bool = False) -> None:
        """Publish states and results if a goal has ended since the last call; with ``force``, always the states."""
        book = self._node.supervisor.goals
        news = book.take_news()
        if not (force or news):
            return
        self._node.outputs.publish_goals(book, news)
        for record in news:
            for listener in self.on_end:
                listener(record)

    def _publish_feedback(self) -> None:
        """Publish the progress towards the current goal, if there is a goal and a pose."""
        supervisor = self._node.supervisor
        present = supervisor.goals.present
        if present is None or supervisor.pose is None:
            return
        distance, elapsed = supervisor.distance_remaining(), supervisor.elapsed
        self._first_distance = max(self._first_distance, distance)
        remaining = time_remaining(distance, self._first_distance, elapsed, supervisor.data_sheet.v_max)
        state = states.CANCELLING if present.is_cancelling else states.DRIVING
        ahead = len(supervisor.goals_ahead)
        feedback = GoalFeedback(present.request.id, state, supervisor.pose, distance, elapsed, remaining, ahead)
        self._node.outputs.publish_feedback(feedback)
        for listener in self.on_feedback:
            listener(feedback)
