"""The client of the service ~/send_goal: a goal that cannot get lost, and its end.

A request is repeated until it is answered; it carries the goal's id, so the controller takes it once. The end comes
on ~/goal_results, whose newest message holds the last ends; without news, the controller is asked.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import rclpy
from action_msgs.srv import CancelGoal
from builtin_interfaces.msg import Duration
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from diffbot_control.goals import goal_record
from diffbot_control.ros.controller_watch import ControllerWatch
from diffbot_control.ros.goals.request import goal_request, new_goal_id
from diffbot_control.ros.messages.conversions import goal_message
from diffbot_control.ros.messages.fields import fill_duration
from diffbot_core.errors import DiffbotError
from diffbot_core.geometry import Pose
from diffbot_core.ros.node import LATCHED, QUEUE

LOST = "lost"
"""End of a goal whose controller is gone, or no longer knows it, since it was restarted."""
ANSWER_TIMEOUT = 1.0
"""[s] after which a request is repeated: an answer can be lost while both sides discover each other."""
_POLL_PERIOD = 2.0
"""[s] without news after which the controller is asked for the state of the goal."""
_SPIN = 0.02
_SEND, _SEND_TYPE = "/send_goal", "rcl_interfaces/srv/SetParametersAtomically"
"""End of the name, and type, of the service of every controller"""


class GoalRefusedError(DiffbotError):
    """The controller refuses the goal; the text says why."""


class NoControllerError(DiffbotError):
    """No controller answers."""


class Feedback(NamedTuple):
    """The fields of NavigateThroughPoses' feedback."""

    current_pose: PoseStamped
    navigation_time: Duration
    estimated_time_remaining: Duration
    distance_remaining: float
    """[m] along straight lines"""
    number_of_poses_remaining: int
    number_of_recoveries: int = 0


class Task:
    """A goal that was sent."""

    def __init__(self, goal_id: str = "") -> None:
        """Start without news; an empty id stands for no goal."""
        self.id = goal_id
        self.end = ""
        """one of goal_record.ENDS or LOST; empty before the end"""
        self.reason = ""
        """of the end, where there is more to say"""
        self.feedback: Feedback | None = None
        self.is_sent = False
        """the controller may have received it"""

    def note(self, state: str) -> None:
        """Take a state as the service answers it."""
        end, _, reason = state.partition(": ")
        if end in (*goal_record.ENDS, LOST) and not self.end:
            self.end, self.reason = end, reason


class GoalClient(Node):  # type: ignore[misc]
    """Sends goals to one controller. Not thread-safe; it spins itself, and must not be added to an executor."""

    def __init__(
        self,
        node_name: str = "goal_client",
        namespace: str = "",
        controller: str = "controller",
        frame: str = "map",
        restart_timeout: float = goal_record.RESTART_TIMEOUT,
        **node_options: Any,
    ) -> None:
        """Create the node and its clients.

        Args:
            node_name: name of this node.
            namespace: namespace of this node and of the robot.
            controller: name of the robot's controller.
            frame: of goals without a frame, and of the poses in the feedback.
            restart_timeout: [s] for which a controller may be away before its goals are LOST; longer for one whose
                process or network pauses.
            node_options: options of rclpy's Node, such as ``context``. Services for its parameters, which it does not
                have, are left out unless ``start_parameter_services`` asks for them.
        """
        node_options.setdefault("start_parameter_services", False)
        super().__init__(node_name, namespace=namespace or None, **node_options)
        self.controller, self.frame = controller, frame
        self.task = Task()
        """the newest goal"""
        self.is_stopped: Callable[[], bool] = lambda: False
        """asked while waiting; True ends the wait as its timeout would"""
        self._last_news = 0.0
        self._question: Any = None
        self._send = self.create_client(SetParametersAtomically, f"{controller}/send_goal")
        self._cancel = self.create_client(CancelGoal, f"{controller}/cancel_goal")
        self.create_subscription(DiagnosticArray, f"{controller}/goal_results", self._on_results, LATCHED)
        self.create_subscription(DiagnosticStatus, f"{controller}/goal_feedback", self._on_feedback, QUEUE)
        self._watch = ControllerWatch(self, controller, restart_timeout)
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self)

    @classmethod
    def in_own_context(cls, **options: Any) -> Any:
        """Return a client with a context of its own, which ends with :meth:`close`; signals stay with the caller."""
        context = rclpy.Context()
        rclpy.init(context=context, signal_handler_options=SignalHandlerOptions.NO)
        return cls(context=context, **options)

    def close(self, shut_down: bool = True) -> None:
        """Leave the graph; shut the context down, too, unless others use it."""
        self._executor.shutdown()
        self.destroy_node()
        if shut_down:
            self.context.try_shutdown()

    def spin_until(self, condition: Callable[[], Any], timeout: float) -> bool:
        """Handle messages until ``condition()`` is true; False if it is not within ``timeout`` [s]."""
        deadline = time.monotonic() + timeout
        while not condition():
            if time.monotonic() >= deadline or self.is_stopped() or not self.context.ok():
                return False
            self._executor.spin_once(timeout_sec=_SPIN)
        return True

    def wait_until_ready(self, timeout: float = math.inf) -> bool:
        """Wait until the controller takes goals; False if it does not within ``timeout`` [s]."""
        return self.spin_until(lambda: self._send.service_is_ready() and self._cancel.service_is_ready(), timeout)

    def seen_controllers(self) -> list[str]:
        """Return the full names of all controllers in this domain that take goals, sorted."""
        found = dict(self.get_service_names_and_types())
        mine = [name for name, types in found.items() if name.endswith(_SEND) and _SEND_TYPE in types]
        mine = [name for name in mine if self.count_services(name) > 0]  # clients are listed, too
        return sorted(name.removesuffix(_SEND) for name in mine)

    def send_goal(self, poses: Sequence[Pose], frame: str = "", timeout: float = math.inf) -> Task:
        """Send a goal, or a path of several, and wait until it is accepted.

        Raises:
            GoalRefusedError: in one line, if it is refused; ``task`` is the former one then.
            NoControllerError: in one line, if no controller answers within ``timeout`` [s], or ``is_stopped``; with
                ``task.is_sent`` the goal may have been accepted all the same, and :meth:`cancel` cancels it.
        """
        former, self.task = self.task, Task(new_goal_id())
        answer = self._ask(goal_request(self.task.id, poses, frame or self.frame), timeout)
        if not answer.successful:
            self.task = former
            raise GoalRefusedError(f"goal refused: {answer.reason}")
        self._last_news = time.monotonic()
        self.task.note(answer.reason)
        return self.task

    def _ask(self, request: SetParametersAtomically.Request, timeout: float) -> Any:
        deadline = time.monotonic() + timeout
        while (left := deadline - time.monotonic()) > 0.0 and self.spin_until(self._send.service_is_ready, left):
            if self.is_stopped():
                break
            future = self._send.call_async(request)
            self.task.is_sent = True
            if self.spin_until(future.done, min(left, ANSWER_TIMEOUT)):
                return future.result().result
            self._send.remove_pending_request(future)
        name = self.resolve_service_name(f"{self.controller}/send_goal")
        raise NoControllerError(f"no answer from {name}: does the controller run, with the same ROS_DOMAIN_ID?")

    def wait_for_end(self, timeout: float) -> bool:
        """Handle messages until the newest goal has ended; False if it has not within ``timeout`` [s]."""
        return self.spin_until(self._has_ended, timeout) or bool(self.task.end)

    def _has_ended(self) -> bool:
        self._poll()
        return bool(self.task.end)

    def _poll(self) -> None:
        """Ask for the state of the goal if nothing was received for long; without a controller, it is lost."""
        now = time.monotonic()
        if not self.task.id or self.task.end:
            return
        if self._watch.is_gone():
            self.task.note(f"{LOST}: the controller is gone")
        if self.task.end or now - self._last_news < _POLL_PERIOD:
            return
        self._last_news = now
        if self._question is not None:
            self._send.remove_pending_request(self._question)
        task = self.task
        self._question = self._send.call_async(goal_request(task.id, (), ""))
        self._question.add_done_callback(lambda future: self._on_answer(task, future))

    def _on_answer(self, task: Task, future: Any) -> None:
        response = None if future.cancelled() else future.result()
        if response is None:
            return
        self._last_news = time.monotonic()
        self._watch.note_sign()
        task.note(response.result.reason if response.result.successful else f"{LOST}: the controller was restarted")

    def cancel(self, timeout: float = 5.0) -> bool:
        """Cancel the newest goal and wait until it has ended, with the robot at rest; False if it has not in time.

        It may end otherwise at the last moment: ``task.end`` tells.
        """
        if not self.task.is_sent:
            return True
        request = CancelGoal.Request()
        request.goal_info.goal_id.uuid = list(bytes.fromhex(self.task.id))
        deadline = time.monotonic() + timeout
        is_accepted = False
        while not self.task.end and (left := deadline - time.monotonic()) > 0.0 and self.context.ok():
            if is_accepted or not self.spin_until(self._cancel.service_is_ready, left):
                self.wait_for_end(left)
                break
            future = self._cancel.call_async(request)
            is_accepted = self.spin_until(future.done, min(left, ANSWER_TIMEOUT))
            self._cancel.remove_pending_request(future)
        return bool(self.task.end)

    def _on_results(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == self.task.id:
                reason = next((pair.value for pair in status.values if pair.key == "reason"), "")
                self.task.note(f"{status.message}: {reason}")

    def _on_feedback(self, message: DiagnosticStatus) -> None:
        if message.name != self.task.id:
            return
        try:
            self.task.feedback = self._feedback_of({pair.key: pair.value for pair in message.values})
        except (KeyError, ValueError, TypeError, OverflowError):
            return  # of another publisher on this topic; the end of the goal is known without it
        self._last_news = time.monotonic()

    def _feedback_of(self, values: dict[str, str]) -> Feedback:
        x, y, theta = (float(word) for word in values["pose"].split())
        feedback = Feedback(
            goal_message(Pose(x, y, theta), self.frame, self.get_clock().now().nanoseconds),
            Duration(),
            Duration(),
            float(values["distance remaining [m]"]),
            int(values["poses remaining"]),
        )
        fill_duration(feedback.navigation_time, float(values["elapsed time [s]"]))
        fill_duration(feedback.estimated_time_remaining, float(values["estimated time remaining [s]"]))
        return feedback
