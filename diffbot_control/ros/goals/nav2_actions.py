"""Nav2's actions ``navigate_to_pose`` and ``navigate_through_poses``, served by the controller.

They exist where nav2_msgs can be imported: on a ROS installation with Nav2's messages. A goal by action is one of the
controller's goals: any newer goal replaces it, whichever way that came.
"""

from __future__ import annotations

from typing import Any

from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path
from rclpy.action.server import ServerGoalHandle

from diffbot_control.goals import goal_record
from diffbot_control.goals.goal_record import GoalRecord
from diffbot_control.ros.goals.action_servers import ActionServers
from diffbot_control.ros.goals.server import GoalFeedback, GoalServer, state_text
from diffbot_control.ros.messages.conversions import goal_message
from diffbot_control.ros.messages.fields import fill_duration
from diffbot_core.errors import BadMessageError
from diffbot_core.ros.node import DiffbotNode

FAILED = 9000
"""error_code of a goal that was not reached: Nav2's *unknown* of this action; error_msg has the reason"""


class Nav2Actions(ActionServers):
    """Both action servers."""

    def __init__(self, node: DiffbotNode[Any], goals: GoalServer, actions: Any) -> None:
        """Create them; ``actions`` is the module nav2_msgs.action."""
        types = {"navigate_to_pose": actions.NavigateToPose, "navigate_through_poses": actions.NavigateThroughPoses}
        super().__init__(node, goals, types)

    def message_of(self, goal: Any) -> PoseStamped | Path:
        """Return the pose, or a path of the poses."""
        if hasattr(goal, "pose"):
            return goal.pose
        if not goal.poses:
            raise BadMessageError("path is empty")
        return Path(header=goal.poses[0].header, poses=list(goal.poses))

    def note_ignored(self, name: str, goal: Any) -> None:
        """Log that there are no behavior trees, once."""
        if goal.behavior_tree:
            self.node.get_logger().info(f"{name}: there are no behavior trees: behavior_tree is ignored", once=True)

    def fill_result(self, result: Any, record: GoalRecord) -> None:
        """Fill in the error."""
        if record.end != goal_record.REACHED:
            result.error_code = FAILED
            result.error_msg = state_text(record)

    def take_feedback(self, handle: ServerGoalHandle, message: Any, feedback: GoalFeedback) -> None:
        """Publish where the robot is, and what remains."""
        now = self.node.get_clock().now().nanoseconds
        message.current_pose = goal_message(feedback.pose, self.node.config.map_frame, now)
        fill_duration(message.navigation_time, feedback.elapsed)
        fill_duration(message.estimated_time_remaining, feedback.remaining)
        message.distance_remaining = feedback.distance
        if hasattr(message, "number_of_poses_remaining"):
            message.number_of_poses_remaining = min(feedback.poses, 32767)
        handle.publish_feedback(message)


def serve_nav2_actions(node: DiffbotNode[Any], goals: GoalServer) -> Nav2Actions | None:
    """Serve the actions if nav2_msgs can be imported; otherwise log that once and return None."""
    try:
        from nav2_msgs import action as actions  # noqa: PLC0415 - no wheel contains it
    except ImportError:
        node.get_logger().info("no nav2_msgs: goals by topic and service, without the action navigate_to_pose")
        return None
    return Nav2Actions(node, goals, actions)
