"""A client of the controller: it sends a goal until the controller has accepted it, and reports how the goal ends.

A goal is a message on goal_pose or path, identified by its frame and stamp. The client repeats the message until the
goal is in ~/goal_status; the controller accepts it once. The end arrives on ~/goal_results. Both topics are latched.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import rclpy
from action_msgs.msg import GoalStatusArray
from action_msgs.srv import CancelGoal
from builtin_interfaces.msg import Duration
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path
from rcl_interfaces.srv import GetParameters
from rclpy.event_handler import SubscriptionEventCallbacks, UnsupportedEventTypeError
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from rclpy.signals import SignalHandlerOptions

from diffbot_control.goals.record import MAX_PATH_POSES, REFUSED, RESTART_TIMEOUT, end_text, goal_id
from diffbot_control.ros.messages.conversions import goal_message
from diffbot_control.ros.messages.fields import fill_duration
from diffbot_core.errors import DiffbotError
from diffbot_core.geometry import Pose
from diffbot_core.ros.qos import LATCHED, QUEUE, STATUS

LOST = "lost"
"""End of a goal whose controller has ended, or was restarted and no longer knows the goal."""
REPEAT_PERIOD = 1.0
"""[s] time after which a message or a request is repeated, because it can be lost during discovery"""
SILENCE = 10.0
"""[s] time without a message after which a controller counts as lost, even if DDS has not reported its end"""
DELAY = 1.0
"""[s] largest delay of a message of a running controller"""
_PAUSE = 0.5
"""[s] If the time between two checks is longer, the client has not handled its messages meanwhile."""
_SPIN = 0.02
"""[s] longest wait for one message"""
_STATES, _STATES_TYPE = "/goal_status", "action_msgs/msg/GoalStatusArray"
"""End of the name, and type, of the topic by which controllers are found."""


class GoalRefusedError(DiffbotError):
    """The controller has refused the goal; the text contains the reason."""


class NoControllerError(DiffbotError):
    """No controller has answered."""


class TaskFeedback(NamedTuple):
    """The fields of the feedback of NavigateThroughPoses and FollowWaypoints."""

    current_pose: PoseStamped
    navigation_time: Duration
    estimated_time_remaining: Duration
    distance_remaining: float
    """[m] along straight lines"""
    number_of_poses_remaining: int
    number_of_recoveries: int = 0
    current_waypoint: int = 0
    """index of the waypoint to which ``followWaypoints`` drives"""


class GoalTask:
    """A goal that was sent, and its end."""

    def __init__(self, goal_id: str = "") -> None:
        """Start without an end; an empty id means that there is no goal."""
        self.id = goal_id
        self.end = ""
        """one of record.ENDS or LOST; empty before the end"""
        self.reason = ""
        """reason of the end; may be empty"""
        self.elapsed = math.nan
        """[s] from the acceptance to the end, as the controller reports it; nan if it does not report the end"""
        self.feedback: TaskFeedback | None = None
        self.is_sent = self.is_accepted = False
        """True if the goal was published; True if the controller has accepted it"""

    @property
    def text(self) -> str:
        """The end in words, with the reason if there is one."""
        return end_text(self.end, self.reason)

    def close(self, end: str, reason: str, elapsed: float = math.nan) -> None:
        """Record the end of the goal; only the first end counts."""
        if not self.end:
            self.end, self.reason, self.elapsed = end, reason, elapsed


class GoalClient(Node):  # type: ignore[misc]
    """Sends goals to one controller. It is not thread-safe. It spins itself, so do not add it to an executor."""

    def __init__(
        self,
        node_name: str = "goal_client",
        namespace: str = "",
        controller: str = "controller",
        frame: str = "map",
        restart_timeout: float = RESTART_TIMEOUT,
        prefix: str = "",
        **node_options: Any,
    ) -> None:
        """Create the node, its publishers and subscriptions.

        Args:
            node_name: name of this node.
            namespace: namespace of this node and of the robot.
            controller: name of the robot's controller.
            frame: frame of goals without a frame, and of the poses in the feedback.
            restart_timeout: [s] grace period before the goals of a controller that disappears are LOST. Increase it if
                the process of the controller or the network pauses.
            prefix: prefix of the topics goal_pose and path; ``dock/`` for the controller that docks.
            node_options: options of rclpy's Node, such as ``context``. By default the node has no parameter services.
        """
        node_options.setdefault("start_parameter_services", False)
        super().__init__(node_name, namespace=namespace or None, **node_options)
        self.controller, self.frame = controller, frame
        self.task = GoalTask()
        """the newest goal"""
        self.problem = ""
        """what keeps the robot from driving, as the controller reports it; may be empty"""
        self.is_stopped: Callable[[], bool] = lambda: False
        """function to call while the client waits; True ends the wait like a timeout"""
        self._known: set[str] = set()
        """ids of the goals in the newest goal_status"""
        self._restart_timeout = restart_timeout
        self._lost: float | None = None
        self._last_sign = self._last_check = time.monotonic()
        self._goals = self.create_publisher(PoseStamped, f"{prefix}goal_pose", QUEUE)
        self._paths = self.create_publisher(Path, f"{prefix}path", QUEUE)
        self._cancel = self.create_client(CancelGoal, f"{controller}/cancel_goal")
        self._states = self.create_subscription(GoalStatusArray, f"{controller}/goal_status", self._on_states, LATCHED)
        self.create_subscription(DiagnosticArray, f"{controller}/goal_results", self._on_results, LATCHED)
        self.create_subscription(DiagnosticStatus, f"{controller}/goal_feedback", self._on_feedback, QUEUE)
        self._watch_controller()
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self)

    @classmethod
    def in_own_context(cls, **options: Any) -> Any:
        """Return a client with its own context and without signal handlers; :meth:`close` shuts the context down."""
        context = rclpy.Context()
        rclpy.init(context=context, signal_handler_options=SignalHandlerOptions.NO)
        return cls(context=context, **options)

    def close(self, shut_down: bool = True) -> None:
        """Destroy the node; with ``shut_down`` also shut the context down."""
        self._executor.shutdown()
        self.destroy_node()
        if shut_down:
            self.context.try_shutdown()

    def spin_until(self, condition: Callable[[], Any], timeout: float) -> bool:
        """Handle messages until ``condition()`` is true; return False if it is not true within ``timeout`` [s]."""
        deadline = time.monotonic() + timeout
        while not condition():
            if time.monotonic() >= deadline or self.is_stopped() or not self.context.ok():
                return False
            self._executor.spin_once(timeout_sec=_SPIN)
        return True

    def wait_until_ready(self, timeout: float = math.inf) -> bool:
        """Wait until the controller can receive goals; return False if it cannot within ``timeout`` [s]."""
        return self.spin_until(self.is_ready, timeout)

    def is_ready(self) -> bool:
        """Return True if the controller can receive goals and cancellations."""
        publishers = self._goals, self._paths
        return (
            self._states.get_publisher_count() > 0
            and all(one.get_subscription_count() > 0 for one in publishers)
            and self._cancel.service_is_ready()
        )

    def seen_controllers(self) -> list[str]:
        """Return the full names of all controllers in this domain, sorted."""
        topics = dict(self.get_topic_names_and_types())
        names = [name for name, types in topics.items() if name.endswith(_STATES) and _STATES_TYPE in types]
        # Without a publisher, there are only clients of a controller.
        return sorted(name.removesuffix(_STATES) for name in names if self.count_publishers(name) > 0)

    def send_goal(self, poses: Sequence[Pose], frame: str = "", timeout: float = math.inf) -> GoalTask:
        """Send a goal, or a path of several poses, and wait until the controller accepts it.

        Raises:
            GoalRefusedError: if the controller refuses the goal, or the path is longer than MAX_PATH_POSES; ``task`` is
                then the previous task.
            NoControllerError: if no controller answers within ``timeout`` [s], or if ``is_stopped`` returns True. If
                ``task.is_sent``, the controller may still have accepted the goal: call :meth:`cancel`.
        """
        if len(poses) > MAX_PATH_POSES:  # the controller does not read, and so does not answer, a far longer message
            raise GoalRefusedError(f"goal refused: path too long: {len(poses)} poses, at most {MAX_PATH_POSES}")
        # The system clock, even if time is simulated, because the stamp identifies the goal.
        frame, stamp = frame or self.frame, time.time_ns()
        previous, self.task = self.task, GoalTask(goal_id(frame, stamp))
        message: Any = goal_message(poses[0], frame, stamp) if poses else None
        if len(poses) != 1:
            message = Path(poses=[goal_message(pose, frame, stamp) for pose in poses])
            message.header.frame_id = frame
            if poses:
                message.header.stamp = message.poses[0].header.stamp
        deadline = time.monotonic() + timeout
        while (left := deadline - time.monotonic()) > 0.0 and self.spin_until(self.is_ready, left):
            if self.is_stopped():
                break
            (self._goals if len(poses) == 1 else self._paths).publish(message)
            self.task.is_sent = True
            if self.spin_until(lambda: self.task.is_accepted or self.task.end, min(left, REPEAT_PERIOD)):
                if self.task.end == REFUSED:
                    refused, self.task = self.task, previous
                    raise GoalRefusedError(f"goal refused: {refused.reason}")
                return self.task
        name = self.resolve_topic_name(f"{self.controller}/goal_status")
        raise NoControllerError(f"no answer on {name}: does the controller run, with the same ROS_DOMAIN_ID?")

    def parameter(self, name: str, timeout: float) -> Any:
        """Return the value of a parameter of the controller; None if it does not answer within ``timeout`` [s]."""
        service = self.create_client(GetParameters, f"{self.controller}/get_parameters")
        deadline = time.monotonic() + timeout
        try:
            while (left := deadline - time.monotonic()) > 0.0 and self.spin_until(service.service_is_ready, left):
                future = service.call_async(GetParameters.Request(names=[name]))
                if self.spin_until(future.done, min(left, REPEAT_PERIOD)):
                    # The list is empty if the node does not have the parameter.
                    return next(map(parameter_value_to_python, future.result().values), None)
                service.remove_pending_request(future)
            return None
        finally:
            self.destroy_client(service)

    def wait_for_end(self, timeout: float) -> bool:
        """Handle messages until the newest goal has ended; return False if it does not end within ``timeout`` [s]."""
        return self.spin_until(self._has_ended, timeout) or bool(self.task.end)

    def _has_ended(self) -> bool:
        if self.task.id and not self.task.end:
            if self._is_gone():
                self.task.close(LOST, "the controller is gone")
            elif self.task.is_accepted and self.task.id not in self._known:
                self.task.close(LOST, "the controller was restarted")
        return bool(self.task.end)

    def cancel(self, timeout: float = 5.0) -> bool:
        """Cancel the newest goal and wait until the robot is at rest; return False if the goal does not end in time.

        The goal may end in another way before it is cancelled: see ``task.end``.
        """
        if not self.task.is_sent:
            return True
        request = CancelGoal.Request()
        request.goal_info.goal_id.uuid = list(bytes.fromhex(self.task.id))
        deadline = time.monotonic() + timeout
        while not self.task.end and (left := deadline - time.monotonic()) > 0.0 and self.context.ok():
            if not self.spin_until(self._cancel.service_is_ready, left):
                self.wait_for_end(left)
                break
            future = self._cancel.call_async(request)
            answered = self.spin_until(future.done, min(left, REPEAT_PERIOD))
            self._cancel.remove_pending_request(future)
            # The controller may not know the goal yet, because the message of the goal is still on its way.
            is_known = answered and future.result().return_code != CancelGoal.Response.ERROR_UNKNOWN_GOAL_ID
            self.wait_for_end(max(deadline - time.monotonic(), 0.0) if is_known else min(left, _PAUSE))
        return bool(self.task.end)

    def _on_states(self, message: GoalStatusArray) -> None:
        self._last_sign = time.monotonic()
        self._known = {bytes(one.goal_info.goal_id.uuid).hex() for one in message.status_list}
        self.task.is_accepted = self.task.is_accepted or self.task.id in self._known

    def _on_results(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == self.task.id:
                values = {pair.key: pair.value for pair in status.values}
                try:
                    elapsed = float(values.get("elapsed time [s]", "nan"))
                except ValueError:  # a message of another publisher
                    elapsed = math.nan
                self.task.close(status.message, values.get("reason", ""), elapsed)

    def _on_feedback(self, message: DiagnosticStatus) -> None:
        self._last_sign = time.monotonic()
        if message.name != self.task.id:
            return
        try:
            self.task.feedback = self._feedback_of({pair.key: pair.value for pair in message.values})
        except (KeyError, ValueError, TypeError, OverflowError):
            return  # a message of another publisher

    def _feedback_of(self, values: dict[str, str]) -> TaskFeedback:
        x, y, theta = (float(word) for word in values["pose"].split())
        feedback = TaskFeedback(
            goal_message(Pose(x, y, theta), self.frame, self.get_clock().now().nanoseconds),
            Duration(),
            Duration(),
            float(values["distance remaining [m]"]),
            int(values["poses remaining"]),
        )
        fill_duration(feedback.navigation_time, float(values["elapsed time [s]"]))
        fill_duration(feedback.estimated_time_remaining, float(values["estimated time remaining [s]"]))
        return feedback

    def _watch_controller(self) -> None:
        """Subscribe to the status, to detect that the controller has ended.

        The publisher of the status has a lease. DDS reports when the lease is not renewed, because the process has
        ended. A process that hangs still renews its lease. The client detects it by the missing status messages, which
        are published twice a second.
        """
        topic = f"{self.controller}/status"
        events = SubscriptionEventCallbacks(liveliness=self._on_liveliness)
        try:
            self.create_subscription(DiagnosticStatus, topic, self._on_status, STATUS, event_callbacks=events)
        except UnsupportedEventTypeError:
            self.create_subscription(DiagnosticStatus, topic, self._on_status, STATUS)

    def _on_status(self, message: DiagnosticStatus) -> None:
        self._last_sign = time.monotonic()
        self.problem = next((pair.value for pair in message.values if pair.key == "problem"), "")

    def _on_liveliness(self, info: Any) -> None:
        if info.alive_count > 0:
            self._lost = None
        elif self._lost is None:
            self._lost = time.monotonic()

    def _is_gone(self) -> bool:
        """Return True if the controller has ended, and was not restarted within the grace period."""
        now = time.monotonic()
        before, self._last_check = self._last_check, now
        if now - before > _PAUSE:  # the client itself has not handled messages
            self._last_sign = now
        # DDS may report a loss too late, or not report the return, so a later message cancels the loss. A busy machine
        # delays messages, so the client waits longer than the controller, which ends its goal after a suspension.
        is_lost = self._lost is not None and (now - max(self._lost, self._last_sign + DELAY) >= self._restart_timeout)
        return is_lost or now - self._last_sign >= self._restart_timeout + SILENCE
