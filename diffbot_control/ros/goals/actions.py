"""Nav2's actions, served by the controller. A newer goal by topic or action replaces the goal of an action.

The actions exist if nav2_msgs can be imported, i.e. in a ROS installation with Nav2's messages. A controller in map
serves ``navigate_to_pose``, ``navigate_through_poses`` and ``follow_path``. A controller in the frame of a dock serves
``dock_robot`` and ``undock_robot``: the goal of docking is (0, 0, 0), and the goal of undocking is the staging pose.

The robot docks where it detects the dock, so ``dock_pose``, ``dock_type`` and ``max_staging_time`` are ignored. The
node does not have a database of docks, so ``use_dock_id`` is refused. The node does not drive in map, so
``navigate_to_staging_pose`` is refused.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from nav_msgs.msg import Path
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle

from diffbot_control.goals.record import CANCELLED, NOT_REACHED, POSE_LOST, REACHED, REFUSED, GoalRecord, GoalRequest
from diffbot_control.goals.states import DRIVING
from diffbot_control.law import docking
from diffbot_control.law.docking_axis import pose_on_axis
from diffbot_control.ros.goals.server import GoalFeedback
from diffbot_control.ros.messages.conversions import goal_message
from diffbot_control.ros.messages.fields import fill_duration
from diffbot_control.ros.parameters.controller import PATHS
from diffbot_core.errors import BadMessageError
from diffbot_core.geometry import Pose

if TYPE_CHECKING:
    from diffbot_control.controller_node import ControllerNode

SOURCE = "action"
FAILED = 9000
"""error_code of a goal that was not reached, for actions that do not define a code: Nav2's unknown error"""
_ERRORS = {NOT_REACHED: "FAILED_TO_MAKE_PROGRESS", POSE_LOST: "TF_ERROR", REFUSED: "INVALID_PATH"}
"""Names of the error codes by the end of the goal; UNKNOWN for the other ends."""
_STATES = {docking.STAGING: "NAV_TO_STAGING_POSE", docking.RETREATING: "RETRY"}
"""States in Nav2's feedback by the phase of docking; CONTROLLING for the other phases."""
_DOCK_ERRORS = {NOT_REACHED: "FAILED_TO_CONTROL", POSE_LOST: "FAILED_TO_DETECT_DOCK"}
"""Names of the error codes of docking by the end of the goal; UNKNOWN for the other ends. If the result does not have
the code, it is FAILED_TO_CONTROL."""


class _DeferredActionServer(ActionServer):  # type: ignore[misc]
    """An action server without a task for each running goal.

    ``handle.execute()`` only marks a goal as executing, and ``notify_execute(handle, finish)`` ends it. The usual task
    is a coroutine that waits for the end of the goal. The SingleThreadedExecutor of rclpy resumes a waiting coroutine
    without pause, which uses a whole processor core.
    """

    def notify_execute(
        self, goal_handle: ServerGoalHandle, execute_callback: Callable[[ServerGoalHandle], Any] | None
    ) -> None:
        """Schedule ``execute_callback``, which sets the final state and returns the result."""
        if execute_callback is not None:
            super().notify_execute(goal_handle, execute_callback)


class ActionServers(ABC):
    """Base class of the action servers of a controller. A subclass translates the messages."""

    NEEDED: tuple[str, ...]
    """names of the types in the module nav2_msgs.action"""

    def __init__(self, node: ControllerNode, actions: Any) -> None:
        """Create the servers; ``actions`` is the module nav2_msgs.action."""
        self.node = node
        self._handles: dict[str, tuple[_DeferredActionServer, ServerGoalHandle]] = {}
        node.goals.on_end.append(self._finish)
        node.goals.on_feedback.append(self._on_feedback)
        names = ("".join(f"_{one.lower()}" if one.isupper() else one for one in kind)[1:] for kind in self.NEEDED)
        self._servers = [
            self._create(name, getattr(actions, kind)) for name, kind in zip(names, self.NEEDED, strict=True)
        ]

    @abstractmethod
    def message_of(self, goal: Any) -> Any:
        """Return the PoseStamped or the path of an action's goal.

        Raises:
            BadMessageError: if the goal of the action cannot be used.
        """

    @abstractmethod
    def fill_result(self, result: Any, record: GoalRecord) -> None:
        """Fill the result of a goal that has ended."""

    @abstractmethod
    def give_feedback(self, handle: ServerGoalHandle, message: Any, feedback: GoalFeedback) -> None:
        """Publish the feedback of a goal; ``message`` is an empty feedback of its action."""

    def destroy(self) -> None:
        """Destroy the servers."""
        for server in self._servers:
            server.destroy()

    def _create(self, name: str, action_type: Any) -> _DeferredActionServer:
        self.node.publisher_watch.watch(f"{name}/_action/status", f"serve {name}")
        server: _DeferredActionServer = _DeferredActionServer(
            self.node,
            action_type,
            name,
            execute_callback=lambda _: action_type.Result(),  # required but never called: see notify_execute
            goal_callback=lambda goal: self._on_goal(name, goal),
            handle_accepted_callback=lambda handle: self._on_accepted(server, handle),
            cancel_callback=lambda handle: self._on_cancel(name, handle),
        )
        return server

    def _on_goal(self, name: str, goal: Any) -> GoalResponse:
        try:
            self.node.goals.goals_of(self.message_of(goal))
        except BadMessageError as error:
            self.node.health.drop(name, error.kind)
            self.node.get_logger().warning(f"{name}: goal rejected: {error}")
            return GoalResponse.REJECT
        return GoalResponse.ACCEPT

    def _on_accepted(self, server: _DeferredActionServer, handle: ServerGoalHandle) -> None:
        goal_id = bytes(handle.goal_id.uuid).hex()
        self._handles[goal_id] = server, handle
        handle.execute()
        try:
            self.node.goals.accept(self.message_of(handle.request), SOURCE, goal_id)
        except BadMessageError as error:
            # Since the check in _on_goal, the node was deactivated, or a transform became too old.
            self.node.supervisor.goals.refuse(
                GoalRequest(goal_id, SOURCE, self.node.clock_watch.now()), REFUSED, str(error)
            )
            self.node.goals.publish_changes()

    def _on_cancel(self, name: str, handle: ServerGoalHandle) -> CancelResponse:
        reason = f"by a client of the action {name}"
        is_cancelled = self.node.goals.cancel_goal(bytes(handle.goal_id.uuid).hex(), reason)
        return CancelResponse.ACCEPT if is_cancelled else CancelResponse.REJECT

    def _finish(self, record: GoalRecord) -> None:
        server, handle = self._handles.pop(record.request.id, (None, None))
        if server is None or handle is None:
            return
        result = server.action_type.Result()
        self.fill_result(result, record)

        def finish(handle: ServerGoalHandle) -> Any:
            # An action goal can end as cancelled only after a request to cancel it.
            if record.end == REACHED:
                handle.succeed()
            elif record.end == CANCELLED and handle.is_cancel_requested:
                handle.canceled()
            else:
                handle.abort()
            return result

        # Not at once, because rclpy marks the goal as cancelling only after the cancel callback.
        server.notify_execute(handle, finish)

    def _on_feedback(self, feedback: GoalFeedback) -> None:
        server, handle = self._handles.get(feedback.id, (None, None))
        if server is not None and handle is not None:
            self.give_feedback(handle, server.action_type.Feedback(), feedback)


class Nav2Actions(ActionServers):
    """The actions that drive to one pose, through several poses, or along a path."""

    NEEDED: tuple[str, ...] = ("NavigateToPose", "NavigateThroughPoses", "FollowPath")

    def __init__(self, node: ControllerNode, actions: Any) -> None:
        """Create the servers; ``actions`` is the module nav2_msgs.action."""
        if node.config.nav2_actions == PATHS:
            self.NEEDED = ("FollowPath",)
        super().__init__(node, actions)

    def message_of(self, goal: Any) -> Any:
        """Return the pose or the path of a goal."""
        if hasattr(goal, "path"):
            if goal.controller_id or goal.goal_checker_id:
                text = (
                    "follow_path: controller_id and goal_checker_id are ignored: there is one law and one goal checker"
                )
                self.node.get_logger().info(text, once=True)
            return goal.path
        if goal.behavior_tree:
            self.node.get_logger().info("behavior_tree is ignored: the controller does not run trees", once=True)
        if hasattr(goal, "pose"):
            return goal.pose
        if not goal.poses:
            raise BadMessageError("path is empty")
        return Path(header=goal.poses[0].header, poses=goal.poses)

    def fill_result(self, result: Any, record: GoalRecord) -> None:
        """Fill in the error if the goal was not reached."""
        if record.end != REACHED:
            unknown = getattr(result, "UNKNOWN", FAILED)
            result.error_code = getattr(result, _ERRORS.get(record.end, "UNKNOWN"), unknown)
            result.error_msg = record.text

    def give_feedback(self, handle: ServerGoalHandle, message: Any, feedback: GoalFeedback) -> None:
        """Publish pose, distance and times."""
        if hasattr(message, "distance_to_goal"):
            message.distance_to_goal = feedback.distance
            message.speed = abs(self.node.outputs.commands.newest.v)
            handle.publish_feedback(message)
            return
        now = self.node.get_clock().now().nanoseconds
        message.current_pose = goal_message(feedback.pose, self.node.config.map_frame, now)
        fill_duration(message.navigation_time, feedback.elapsed)
        fill_duration(message.estimated_time_remaining, feedback.remaining)
        message.distance_remaining = feedback.distance
        if hasattr(message, "number_of_poses_remaining"):
            message.number_of_poses_remaining = min(feedback.poses, 32767)
        handle.publish_feedback(message)


class DockActions(ActionServers):
    """The actions that dock and undock; the law of the controller is :class:`docking.Docking`."""

    NEEDED = ("DockRobot", "UndockRobot")

    def __init__(self, node: ControllerNode, actions: Any) -> None:
        """Create the servers; ``actions`` is the module nav2_msgs.action."""
        self._tries: tuple[str, int] = "", 0
        """id of the goal of the newest feedback, and number of its approaches that were broken off"""
        super().__init__(node, actions)

    def message_of(self, goal: Any) -> Any:
        """Return the goal in the dock's frame."""
        config: Any = self.node.supervisor.config.controller
        if hasattr(goal, "max_undocking_time"):
            if not goal.max_undocking_time > 0.0:
                raise BadMessageError("max_undocking_time is not positive", f"{goal.max_undocking_time:g} s")
            pose = pose_on_axis(config.staging_distance, config.dock_backward)
        elif goal.use_dock_id:
            raise BadMessageError("use_dock_id is true", "the node does not have a database of docks")
        elif goal.navigate_to_staging_pose:
            raise BadMessageError(
                "navigate_to_staging_pose is true", "first drive to a pose from which the robot detects the dock"
            )
        else:
            pose = Pose(0.0, 0.0, 0.0)
        return goal_message(pose, self.node.config.map_frame, 0)

    def fill_result(self, result: Any, record: GoalRecord) -> None:
        """Fill in success, error and the number of retries."""
        result.success = record.end == REACHED
        if not result.success:
            name = _DOCK_ERRORS.get(record.end, "UNKNOWN")
            result.error_code = getattr(result, name, result.FAILED_TO_CONTROL)
            result.error_msg = record.text
        if hasattr(result, "num_retries"):
            goal, tries = self._tries
            # If another goal has replaced this goal, the memory of the law is already new.
            result.num_retries = max(self.node.supervisor.memory.stage.tries, tries if goal == record.request.id else 0)

    def give_feedback(self, handle: ServerGoalHandle, message: Any, feedback: GoalFeedback) -> None:
        """Publish the phase of docking; give up an undocking that takes too long."""
        stage = self.node.supervisor.memory.stage
        self._tries = feedback.id, stage.tries
        if hasattr(message, "docking_time"):
            message.state = getattr(message, _STATES.get(stage.phase, "CONTROLLING"))
            fill_duration(message.docking_time, feedback.elapsed)
            message.num_retries = stage.tries
            handle.publish_feedback(message)
        elif feedback.state == DRIVING and feedback.elapsed > handle.request.max_undocking_time:
            self.node.supervisor.give_up(
                f"not undocked within max_undocking_time = {handle.request.max_undocking_time:g} s"
            )
            self.node.goals.publish_changes()


def serve(kind: type[ActionServers], node: ControllerNode) -> ActionServers | None:
    """Create the servers if nav2_msgs contains their actions; otherwise log this and return None."""
    try:
        from nav2_msgs import action as actions  # noqa: PLC0415 - no wheel contains it
    except ImportError:
        actions = None
    missing = [name for name in kind.NEEDED if not hasattr(actions, name)]
    if missing:
        node.get_logger().info(
            f"nav2_msgs.action.{missing[0]} cannot be imported: the controller accepts goals by topic only"
        )
        return None
    return kind(node, actions)
