"""Nav2's actions ``navigate_to_pose`` and ``navigate_through_poses``, served by the controller.

They exist where nav2_msgs can be imported: on a ROS installation with Nav2's messages, or after ``diffbot interfaces
build``. A goal by action is one of the controller's goals: any newer goal replaces it, whichever way that came.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle

from diffbot_control.goals import goal_record
from diffbot_control.goals.goal_record import GoalRecord
from diffbot_control.ros.goals.server import GoalFeedback, GoalServer, state_text
from diffbot_control.ros.messages.conversions import goal_message
from diffbot_control.ros.messages.fields import fill_duration
from diffbot_core.errors import BadMessageError
from diffbot_core.ros.node import DiffbotNode

SOURCE = "action"
FAILED = 9000
"""error_code of a goal that was not reached: Nav2's *unknown* of this action; error_msg has the reason"""


class _DeferredActionServer(ActionServer):  # type: ignore[misc]
    """An action server whose goals take no task while they run.

    ``handle.execute()`` only marks a goal as executing; ``notify_execute(handle, finish)`` ends it. rclpy would have a
    coroutine wait for the end, which its SingleThreadedExecutor resumes again and again, with a whole processor.
    """

    def notify_execute(
        self, goal_handle: ServerGoalHandle, execute_callback: Callable[[ServerGoalHandle], Any] | None
    ) -> None:
        """Schedule ``execute_callback``, which has to set the final state and return the result."""
        if execute_callback is not None:
            super().notify_execute(goal_handle, execute_callback)


class Nav2Actions:
    """Both action servers."""

    def __init__(self, node: DiffbotNode[Any], goals: GoalServer, actions: Any) -> None:
        """Create them; ``actions`` is the module nav2_msgs.action."""
        self._node, self._goals = node, goals
        self._handles: dict[str, tuple[_DeferredActionServer, ServerGoalHandle]] = {}
        goals.on_end.append(self._finish)
        goals.on_feedback.append(self._publish_feedback)
        types = {"navigate_to_pose": actions.NavigateToPose, "navigate_through_poses": actions.NavigateThroughPoses}
        self._servers = [self._create(name, action_type) for name, action_type in types.items()]

    def destroy(self) -> None:
        """Take both out of service."""
        for server in self._servers:
            server.destroy()

    def _create(self, name: str, action_type: Any) -> _DeferredActionServer:
        server: _DeferredActionServer = _DeferredActionServer(
            self._node,
            action_type,
            name,
            execute_callback=lambda _: action_type.Result(),  # required, never called: see notify_execute
            goal_callback=lambda goal: self._on_goal(name, goal),
            handle_accepted_callback=lambda handle: self._on_accepted(server, handle),
            cancel_callback=self._on_cancel,
        )
        return server

    def _on_goal(self, name: str, goal: Any) -> GoalResponse:
        try:
            self._goals.check(_message_of(goal))
        except BadMessageError as error:
            self._node.health.drop(name, error.kind)
            self._node.get_logger().warning(f"{name}: goal rejected: {error}")
            return GoalResponse.REJECT
        if goal.behavior_tree:
            self._node.get_logger().info(f"{name}: there are no behavior trees: behavior_tree is ignored", once=True)
        return GoalResponse.ACCEPT

    def _on_accepted(self, server: _DeferredActionServer, handle: ServerGoalHandle) -> None:
        goal_id = bytes(handle.goal_id.uuid).hex()
        self._handles[goal_id] = server, handle
        handle.execute()
        self._goals.accept(_message_of(handle.request), SOURCE, goal_id)

    def _on_cancel(self, handle: ServerGoalHandle) -> CancelResponse:
        is_cancelled = self._goals.cancel(bytes(handle.goal_id.uuid).hex())
        return CancelResponse.ACCEPT if is_cancelled else CancelResponse.REJECT

    def _finish(self, record: GoalRecord) -> None:
        server, handle = self._handles.pop(record.request.id, (None, None))
        if server is None or handle is None:
            return

        def finish(handle: ServerGoalHandle) -> Any:
            result = server.action_type.Result()
            if record.end == goal_record.REACHED:
                handle.succeed()
                return result
            # A goal that was cancelled by other ways than the action cannot end as cancelled there.
            if record.end == goal_record.CANCELLED and handle.is_cancel_requested:
                handle.canceled()
            else:
                handle.abort()
            result.error_code = FAILED
            result.error_msg = state_text(record)
            return result

        # As a task, not at once: within the cancel callback, rclpy has not marked the goal as cancelling yet.
        server.notify_execute(handle, finish)

    def _publish_feedback(self, feedback: GoalFeedback) -> None:
        server, handle = self._handles.get(feedback.id, (None, None))
        if server is None or handle is None:
            return
        message = server.action_type.Feedback()
        now = self._node.get_clock().now().nanoseconds
        message.current_pose = goal_message(feedback.pose, self._node.config.map_frame, now)
        fill_duration(message.navigation_time, feedback.elapsed)
        fill_duration(message.estimated_time_remaining, feedback.remaining)
        message.distance_remaining = feedback.distance
        if hasattr(message, "number_of_poses_remaining"):
            message.number_of_poses_remaining = min(feedback.poses, 32767)
        handle.publish_feedback(message)


def _message_of(goal: Any) -> PoseStamped | Path:
    if hasattr(goal, "pose"):
        return goal.pose
    if not goal.poses:
        raise BadMessageError("path is empty")
    return Path(header=goal.poses[0].header, poses=list(goal.poses))


def serve_nav2_actions(node: DiffbotNode[Any], goals: GoalServer) -> Nav2Actions | None:
    """Serve the actions if nav2_msgs can be imported; otherwise log that once and return None."""
    try:
        from nav2_msgs import action as actions  # noqa: PLC0415 - no wheel contains it
    except ImportError:
        node.get_logger().info("no nav2_msgs: goals by topic and service, without the action navigate_to_pose")
        return None
    return Nav2Actions(node, goals, actions)
