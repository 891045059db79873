"""Goals with answers, of the controller: every accepted goal is announced, reported on, and ended once.

Goals from the topics, the service ~/send_goal and the actions share one :class:`diffbot_control.goals.GoalBook`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

from action_msgs.msg import GoalInfo, GoalStatus, GoalStatusArray
from action_msgs.srv import CancelGoal
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path
from rcl_interfaces.srv import SetParametersAtomically

from diffbot_control.goals import goal_record
from diffbot_control.goals.goal_record import GoalRecord, GoalRequest, time_remaining
from diffbot_control.goals.supervisor import Supervisor
from diffbot_control.ros.goals.intake import TOPIC as GOAL_TOPIC
from diffbot_control.ros.goals.intake import GoalIntake
from diffbot_control.ros.goals.path_intake import TOPIC as PATH_TOPIC
from diffbot_control.ros.goals.path_intake import PathIntake
from diffbot_control.ros.goals.request import new_goal_id, read_goal_request
from diffbot_control.ros.messages.fields import set_stamp
from diffbot_core.errors import DiffbotError
from diffbot_core.geometry import Pose
from diffbot_core.ros.node import LATCHED, QUEUE, DiffbotNode, status_message
from diffbot_core.units import NS_PER_S

FEEDBACK_PERIOD = 0.2
"""[s] between two messages of feedback"""
REQUEST = "request"
DRIVING, CANCELLING = "driving", "cancelling"
"""States of a goal that has not ended; after it, the state is one of goal_record.ENDS."""
_STATUS = {
    goal_record.REACHED: GoalStatus.STATUS_SUCCEEDED,
    goal_record.CANCELLED: GoalStatus.STATUS_CANCELED,
}
"""Of an ended goal; the other ends are STATUS_ABORTED, as Nav2 reports them."""


class GoalFeedback(NamedTuple):
    """How far the present goal is."""

    id: str
    state: str
    """DRIVING or CANCELLING"""
    pose: Pose
    distance: float
    """[m] that remains, along straight lines"""
    elapsed: float
    """[s] since the goal was accepted"""
    remaining: float
    """[s] estimated"""
    poses: int
    """goals of the path that remain"""


class GoalServer:
    """The controller's side of all goals."""

    def __init__(
        self,
        node: DiffbotNode[Any],
        supervisor: Supervisor,
        goals_of: Callable[[PoseStamped | Path], list[Pose]],
        now: Callable[[], float],
        cancel: Callable[[], bool],
        changed: Callable[[], None],
    ) -> None:
        """Create topics, services and the timer of the feedback.

        Args:
            node: the controller; its configuration has ``map_frame``.
            supervisor: what drives.
            goals_of: the goals of a message; raises BadMessageError for one that cannot be used.
            now: time [s] on the clock of the supervisor.
            cancel: cancels the goal and starts to stop the robot; False if there was none.
            changed: called after a goal was accepted.
        """
        self._node, self.supervisor, self._now = node, supervisor, now
        self.check = goals_of
        self._cancel, self._changed = cancel, changed
        self.on_end: list[Callable[[GoalRecord], None]] = []
        """called once with each goal that has ended"""
        self.on_feedback: list[Callable[[GoalFeedback], None]] = []
        """called every FEEDBACK_PERIOD while a goal is driven to"""
        self.paths = PathIntake(node, lambda goals: self.accept_goals(goals, True, PATH_TOPIC))
        """reads paths from the topic"""
        self.singles = GoalIntake(node, lambda goal: self.accept_goals([goal], False, GOAL_TOPIC))
        """accepts goals from the topic"""
        self._first_distance = 0.0
        self._statuses = node.create_publisher(GoalStatusArray, "~/goal_status", LATCHED)
        self._results = node.create_publisher(DiagnosticArray, "~/goal_results", LATCHED)
        self._feedbacks = node.create_publisher(DiagnosticStatus, "~/goal_feedback", QUEUE)
        node.create_service(SetParametersAtomically, "~/send_goal", self._on_send_goal)
        node.create_service(CancelGoal, "~/cancel_goal", self._on_cancel_goal)
        node.create_timer(FEEDBACK_PERIOD, self._publish_feedback, clock=node.steady_clock)

    def accept(self, message: PoseStamped | Path, source: str, goal_id: str = "") -> None:
        """Drive to a goal or along a path.

        Raises:
            BadMessageError: if it cannot be used; nothing changes then.
        """
        self.accept_goals(self.check(message), isinstance(message, Path), source, goal_id)

    def accept_goals(self, goals: list[Pose], is_path: bool, source: str, goal_id: str = "") -> None:
        """Drive to a checked goal or along a path of checked goals; what is not accepted yet is dropped."""
        self.drop_pending()
        request = GoalRequest(goal_id or new_goal_id(), source, self._now())
        if is_path:
            self.supervisor.on_path(goals, request)
            text = f"path of {len(goals)} goals"
        else:
            self.supervisor.on_goal(goals[0], request)
            text = "goal: x {:.3f} m, y {:.3f} m, heading {:.3f} rad".format(*goals[0])
        self._first_distance = 0.0
        self._node.get_logger().info(text)
        self._changed()
        self.publish_changes(force=True)

    def drop_pending(self) -> bool:
        """Drop a path that is still being read, and a goal that waits; return whether there was one."""
        # Both are dropped, whatever the first one returns.
        return any([self.paths.drop(), self.singles.drop()])

    def cancel(self, goal_id: str) -> bool:
        """Cancel the present goal if it is ``goal_id``; return whether it was."""
        present = self.supervisor.goals.present
        return present is not None and present.request.id == goal_id and self._cancel_present(present)

    def _cancel_present(self, present: GoalRecord) -> bool:
        return present.is_cancelling or self._cancel()

    def publish_changes(self, force: bool = False) -> None:
        """Publish the goals that have ended since the last call; with ``force``, their states in any case."""
        book = self.supervisor.goals
        if not (force or book.has_news):
            return
        news = book.take_news()
        ended = [record for record in book.ended if record.request.id]
        if news:
            self._results.publish(DiagnosticArray(status=[_result_message(record) for record in ended]))
        present = [book.present] if book.present is not None and book.present.request.id else []
        self._statuses.publish(GoalStatusArray(status_list=[_status_of(record) for record in (*ended, *present)]))
        for record in news:
            for listener in self.on_end:
                listener(record)

    def feedback(self) -> GoalFeedback | None:
        """Return how far the present goal is, None without a goal or before the first pose."""
        supervisor = self.supervisor
        present = supervisor.goals.present
        if present is None or supervisor.pose is None:
            return None
        distance, elapsed = supervisor.distance_remaining(), present.elapsed(self._now())
        self._first_distance = max(self._first_distance, distance)
        max_speed = getattr(getattr(supervisor.config.controller, "data_sheet", None), "v_max", math.inf)
        remaining = time_remaining(distance, self._first_distance, elapsed, max_speed)
        state = CANCELLING if present.is_cancelling else DRIVING
        return GoalFeedback(
            present.request.id, state, supervisor.pose, distance, elapsed, remaining, len(supervisor.goals_ahead)
        )

    def _publish_feedback(self) -> None:
        feedback = self.feedback()
        if feedback is None:
            return
        if self._feedbacks.get_subscription_count():
            self._feedbacks.publish(_feedback_message(feedback))
        for listener in self.on_feedback:
            listener(feedback)

    def _on_send_goal(
        self, request: SetParametersAtomically.Request, response: SetParametersAtomically.Response
    ) -> SetParametersAtomically.Response:
        try:
            sent = read_goal_request(request, self._node.config.map_frame)
            known = self.supervisor.goals.find(sent.id)
            if known is None and sent.message is None:
                raise DiffbotError(f"goal {sent.id} is unknown")
            if known is None and sent.message is not None:
                # A repeated request is the same goal, also after its end: the client may have missed the answer.
                self.accept(sent.message, REQUEST, sent.id)
                known = self.supervisor.goals.find(sent.id)
        except DiffbotError as error:
            response.result.successful, response.result.reason = False, str(error)
        else:
            response.result.successful = True
            response.result.reason = state_text(known) if known is not None else DRIVING
        return response

    def _on_cancel_goal(self, request: CancelGoal.Request, response: CancelGoal.Response) -> CancelGoal.Response:
        """Cancel as action_msgs/srv/CancelGoal says: one goal, or all that were accepted until a time."""
        book, goal_id = self.supervisor.goals, bytes(request.goal_info.goal_id.uuid).hex()
        is_named, until = bool(goal_id.strip("0")), request.goal_info.stamp
        has_time = bool(until.sec or until.nanosec)
        if is_named and not has_time and book.find(goal_id) is None:
            response.return_code = CancelGoal.Response.ERROR_UNKNOWN_GOAL_ID
            return response
        present = book.present
        is_meant = present is not None and (
            present.request.id == goal_id
            or (has_time and round(present.request.time * NS_PER_S) <= until.sec * NS_PER_S + until.nanosec)
            or not (is_named or has_time)
        )
        if present is not None and is_meant and self._cancel_present(present):
            response.goals_canceling = [_info_of(present)]
        elif is_named:
            response.return_code = CancelGoal.Response.ERROR_GOAL_TERMINATED
        else:
            response.return_code = CancelGoal.Response.ERROR_REJECTED
        return response


def state_text(record: GoalRecord) -> str:
    """Return the state of a goal, with the reason if it has one: ``not reached: ...``."""
    if not record.end:
        return CANCELLING if record.is_cancelling else DRIVING
    return f"{record.end}: {record.reason}" if record.reason else record.end


def _info_of(record: GoalRecord) -> GoalInfo:
    info = GoalInfo()
    info.goal_id.uuid = list(bytes.fromhex(record.request.id))
    set_stamp(info.stamp, round(record.request.time * NS_PER_S))
    return info


def _status_of(record: GoalRecord) -> GoalStatus:
    if record.end:
        status = _STATUS.get(record.end, GoalStatus.STATUS_ABORTED)
    else:
        status = GoalStatus.STATUS_CANCELING if record.is_cancelling else GoalStatus.STATUS_EXECUTING
    return GoalStatus(goal_info=_info_of(record), status=status)


def _result_message(record: GoalRecord) -> DiagnosticStatus:
    level = 0 if record.end == goal_record.REACHED else DiagnosticStatus.WARN[0]
    values = {
        "reason": record.reason,
        "source": record.request.source,
        "elapsed time [s]": f"{record.elapsed(record.ended):.3f}",
    }
    return status_message(record.request.id, level, record.end, values)


def _feedback_message(feedback: GoalFeedback) -> DiagnosticStatus:
    values = {
        "distance remaining [m]": f"{feedback.distance:.4f}",
        "elapsed time [s]": f"{feedback.elapsed:.3f}",
        "estimated time remaining [s]": f"{feedback.remaining:.3f}",
        "poses remaining": str(feedback.poses),
        "pose": " ".join(f"{number:.6g}" for number in feedback.pose),
    }
    return status_message(feedback.id, 0, feedback.state, values)
