"""Nav2's actions ``dock_robot`` and ``undock_robot``, served by the controller in the dock's frame.

They exist where nav2_msgs can be imported. Docking is the goal (0, 0, 0), undocking the staging pose. The dock is
where it is detected: ``dock_pose``, ``dock_type`` and ``max_staging_time`` are ignored. There is no database of docks
and no drive in map, so ``use_dock_id`` and ``navigate_to_staging_pose`` are refused.
"""

from __future__ import annotations

from typing import Any

from geometry_msgs.msg import PoseStamped
from rclpy.action.server import ServerGoalHandle

from diffbot_control.goals import goal_record
from diffbot_control.goals.goal_record import GoalRecord
from diffbot_control.law import docking
from diffbot_control.law.docking_axis import pose_on_axis
from diffbot_control.ros.goals.action_servers import ActionServers
from diffbot_control.ros.goals.server import DRIVING, GoalFeedback, GoalServer, state_text
from diffbot_control.ros.messages.conversions import goal_message
from diffbot_control.ros.messages.fields import fill_duration
from diffbot_core.errors import BadMessageError
from diffbot_core.geometry import Pose
from diffbot_core.ros.node import DiffbotNode

_STATES = {docking.STAGING: "NAV_TO_STAGING_POSE", docking.RETREATING: "RETRY"}
"""States of Nav2's feedback for phases of the law; in the others it is CONTROLLING."""
_ERRORS = {goal_record.NOT_REACHED: "FAILED_TO_CONTROL", goal_record.POSE_LOST: "FAILED_TO_DETECT_DOCK"}
"""Names of error codes; UNKNOWN after another end, FAILED_TO_CONTROL where an action lacks the code."""


class DockActions(ActionServers):
    """Both action servers; the law of the controller is :class:`docking.Docking`."""

    def __init__(self, node: DiffbotNode[Any], goals: GoalServer, actions: Any) -> None:
        """Create them; ``actions`` is the module nav2_msgs.action."""
        self._tries: tuple[str, int] = "", 0
        """a goal and its approaches broken off, at its newest feedback"""
        super().__init__(node, goals, {"dock_robot": actions.DockRobot, "undock_robot": actions.UndockRobot})

    def message_of(self, goal: Any) -> PoseStamped:
        """Return the goal in the dock's frame."""
        config: Any = self.goals.supervisor.config.controller
        if hasattr(goal, "max_undocking_time"):
            if not goal.max_undocking_time > 0.0:
                raise BadMessageError("max_undocking_time is not positive", f"{goal.max_undocking_time:g} s")
            pose = pose_on_axis(config.staging_distance, config.dock_backward)
        elif goal.use_dock_id:
            raise BadMessageError("use_dock_id is true", "there is no database of docks")
        elif goal.navigate_to_staging_pose:
            raise BadMessageError(
                "navigate_to_staging_pose is true", "drive to a pose from which the dock is seen first"
            )
        else:
            pose = Pose(0.0, 0.0, 0.0)
        return goal_message(pose, self.node.config.map_frame, 0)

    def fill_result(self, result: Any, record: GoalRecord) -> None:
        """Fill in success, error and the approaches broken off."""
        result.success = record.end == goal_record.REACHED
        if not result.success:
            name = _ERRORS.get(record.end, "UNKNOWN")
            result.error_code = getattr(result, name, result.FAILED_TO_CONTROL)
            result.error_msg = state_text(record)
        if hasattr(result, "num_retries"):
            goal, tries = self._tries
            # The memory is new already if another goal has replaced this one.
            result.num_retries = max(self.goals.supervisor.memory.tries, tries if goal == record.request.id else 0)

    def take_feedback(self, handle: ServerGoalHandle, message: Any, feedback: GoalFeedback) -> None:
        """Publish the phase of docking; end an undocking that takes too long."""
        memory = self.goals.supervisor.memory
        self._tries = feedback.id, memory.tries
        if hasattr(message, "docking_time"):
            message.state = getattr(message, _STATES.get(memory.phase, "CONTROLLING"))
            fill_duration(message.docking_time, feedback.elapsed)
            message.num_retries = memory.tries
            handle.publish_feedback(message)
        elif feedback.state == DRIVING and feedback.elapsed > handle.request.max_undocking_time:
            self.goals.supervisor.give_up(f"not within max_undocking_time = {handle.request.max_undocking_time:g} s")
            self.goals.publish_changes()


def serve_dock_actions(node: DiffbotNode[Any], goals: GoalServer) -> DockActions | None:
    """Serve the actions if nav2_msgs with them can be imported; otherwise log that once and return None."""
    try:
        from nav2_msgs import action as actions  # noqa: PLC0415 - no wheel contains it
    except ImportError:
        actions = None
    if not (hasattr(actions, "DockRobot") and hasattr(actions, "UndockRobot")):
        node.get_logger().info("no DockRobot in nav2_msgs: docking by service, without the action dock_robot")
        return None
    return DockActions(node, goals, actions)
