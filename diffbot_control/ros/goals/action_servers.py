"""Action servers whose goals are the controller's: any newer goal replaces one by action, whichever way that came."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any

from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle

from diffbot_control.goals import goal_record
from diffbot_control.goals.goal_record import GoalRecord
from diffbot_control.ros.goals.server import GoalFeedback, GoalServer
from diffbot_core.errors import BadMessageError
from diffbot_core.ros.node import DiffbotNode

SOURCE = "action"


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


class ActionServers(ABC):
    """Action servers of one controller. A subclass translates their messages."""

    def __init__(self, node: DiffbotNode[Any], goals: GoalServer, types: Mapping[str, Any]) -> None:
        """Create a server for each name of an action and its type."""
        self.node, self.goals = node, goals
        self._handles: dict[str, tuple[_DeferredActionServer, ServerGoalHandle]] = {}
        goals.on_end.append(self._finish)
        goals.on_feedback.append(self._take_feedback)
        self._servers = [self._create(name, action_type) for name, action_type in types.items()]

    @abstractmethod
    def message_of(self, goal: Any) -> PoseStamped | Path:
        """Return the goal of the controller.

        Raises:
            BadMessageError: if the goal of the action cannot be used.
        """

    def note_ignored(self, name: str, goal: Any) -> None:  # noqa: B027 - most goals have nothing to ignore
        """Log what is ignored of an accepted goal of the action ``name``."""

    @abstractmethod
    def fill_result(self, result: Any, record: GoalRecord) -> None:
        """Fill the result of an ended goal."""

    @abstractmethod
    def take_feedback(self, handle: ServerGoalHandle, message: Any, feedback: GoalFeedback) -> None:
        """Publish the feedback of a goal; ``message`` is an empty one of its action."""

    def destroy(self) -> None:
        """Take them out of service."""
        for server in self._servers:
            server.destroy()

    def _create(self, name: str, action_type: Any) -> _DeferredActionServer:
        server: _DeferredActionServer = _DeferredActionServer(
            self.node,
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
            self.goals.check(self.message_of(goal))
        except BadMessageError as error:
            self.node.health.drop(name, error.kind)
            self.node.get_logger().warning(f"{name}: goal rejected: {error}")
            return GoalResponse.REJECT
        self.note_ignored(name, goal)
        return GoalResponse.ACCEPT

    def _on_accepted(self, server: _DeferredActionServer, handle: ServerGoalHandle) -> None:
        goal_id = bytes(handle.goal_id.uuid).hex()
        self._handles[goal_id] = server, handle
        handle.execute()
        self.goals.accept(self.message_of(handle.request), SOURCE, goal_id)

    def _on_cancel(self, handle: ServerGoalHandle) -> CancelResponse:
        is_cancelled = self.goals.cancel(bytes(handle.goal_id.uuid).hex())
        return CancelResponse.ACCEPT if is_cancelled else CancelResponse.REJECT

    def _finish(self, record: GoalRecord) -> None:
        server, handle = self._handles.pop(record.request.id, (None, None))
        if server is None or handle is None:
            return
        result = server.action_type.Result()
        self.fill_result(result, record)

        def finish(handle: ServerGoalHandle) -> Any:
            # A goal that was cancelled by other ways than the action cannot end as cancelled there.
            if record.end == goal_record.REACHED:
                handle.succeed()
            elif record.end == goal_record.CANCELLED and handle.is_cancel_requested:
                handle.canceled()
            else:
                handle.abort()
            return result

        # As a task, not at once: within the cancel callback, rclpy has not marked the goal as cancelling yet.
        server.notify_execute(handle, finish)

    def _take_feedback(self, feedback: GoalFeedback) -> None:
        server, handle = self._handles.get(feedback.id, (None, None))
        if server is not None and handle is not None:
            self.take_feedback(handle, server.action_type.Feedback(), feedback)
