"""Send goals and wait for their ends, from a Python program.

The names are those of nav2_simple_commander's BasicNavigator, but no action is needed: goals go through the
controller's service ~/send_goal, which cannot lose one. A program that drives to one goal::

    import rclpy
    from geometry_msgs.msg import PoseStamped
    from diffbot_control.ros.navigator import Navigator, TaskResult

    rclpy.init()
    navigator = Navigator()
    goal = PoseStamped()
    goal.header.frame_id = "map"
    goal.pose.position.x, goal.pose.orientation.w = 2.0, 1.0
    if navigator.goToPose(goal):
        while not navigator.isTaskComplete():
            feedback = navigator.getFeedback()
            if feedback is not None:
                print(f"{feedback.distance_remaining:.2f} m to go")
    print(navigator.getResult() == TaskResult.SUCCEEDED, navigator.getReason())
    navigator.destroyNode()
    rclpy.shutdown()
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from enum import Enum
from typing import Any

from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped

from diffbot_control.goals import goal_record
from diffbot_control.law.docking_axis import pose_on_axis
from diffbot_control.ros.goals.client import ANSWER_TIMEOUT, LOST, Feedback, GoalClient, GoalRefusedError
from diffbot_control.ros.messages.fields import pose_of
from diffbot_core.errors import DiffbotError
from diffbot_core.geometry import Pose
from diffbot_core.ros.node import QUEUE

_NEAR = 1.0
"""[m] an estimate this close to the initial pose follows from it"""


class TaskResult(Enum):
    """How a task ended, with the names of nav2_simple_commander."""

    UNKNOWN = 0
    SUCCEEDED = 1
    CANCELED = 2
    FAILED = 3


_RESULTS = {"": TaskResult.UNKNOWN, LOST: TaskResult.UNKNOWN} | {
    goal_record.REACHED: TaskResult.SUCCEEDED,
    goal_record.CANCELLED: TaskResult.CANCELED,
}


class Navigator(GoalClient):
    """BasicNavigator's way to drive to goals; see :class:`GoalClient` for the arguments."""

    def __init__(self, node_name: str = "navigator", namespace: str = "", **options: Any) -> None:
        """Create the node, its clients and the publisher of ``initialpose``; ``options`` hold for docking, too."""
        super().__init__(node_name, namespace, **options)
        self._names = f"{node_name}_dock", namespace
        self._options = {**options, "context": self.context}
        self._docking: GoalClient | None = None
        """of the dock's controller, made when it is needed"""
        self._present: GoalClient = self
        """which of the two has the newest goal"""
        self._initial_poses = self.create_publisher(PoseWithCovarianceStamped, "initialpose", QUEUE)

    def destroyNode(self) -> None:  # noqa: N802 - the names of BasicNavigator, here and below
        """Leave the graph; the context stays."""
        if self._docking is not None:
            self._docking.close(shut_down=False)
        self.close(shut_down=False)

    def waitUntilReady(self, timeout: float = math.inf) -> bool:  # noqa: N802
        """Wait until the controller takes goals; False if it does not within ``timeout`` [s]."""
        return self.wait_until_ready(timeout)

    def waitUntilNav2Active(self, navigator: str = "", localizer: str = "") -> None:  # noqa: N802
        """Do the same without a limit, for programs written for BasicNavigator; the arguments are ignored."""
        self.wait_until_ready()

    def setInitialPose(  # noqa: N802
        self, initial_pose: PoseStamped, sigma_xy: float = 0.1, sigma_yaw: float = 0.1, timeout: float = 10.0
    ) -> bool:
        """Initialise the filter, and wait until it publishes a pose within 1 m of that.

        Args:
            initial_pose: in the frame of the map.
            sigma_xy: [m] its standard deviation in x and in y.
            sigma_yaw: [rad] that of its heading.
            timeout: [s]; False is returned after it.
        """
        message = PoseWithCovarianceStamped(header=initial_pose.header)
        message.header.frame_id = message.header.frame_id or self.frame
        message.pose.pose = initial_pose.pose
        message.pose.covariance[0] = message.pose.covariance[7] = sigma_xy**2
        message.pose.covariance[35] = sigma_yaw**2
        meant, received = pose_of(initial_pose.pose), list[Pose]()

        def is_followed() -> bool:
            return any(math.hypot(pose.x - meant.x, pose.y - meant.y) <= _NEAR for pose in received)

        subscription = self.create_subscription(
            PoseWithCovarianceStamped, "pose", lambda pose: received.append(pose_of(pose.pose.pose)), QUEUE
        )
        deadline = time.monotonic() + timeout
        try:
            while (left := deadline - time.monotonic()) > 0.0:
                # Repeated until it shows: the filter may not have discovered this publisher yet.
                if self.spin_until(self._initial_poses.get_subscription_count, left):
                    received.clear()
                    self._initial_poses.publish(message)
                    if self.spin_until(is_followed, min(left, ANSWER_TIMEOUT)):
                        return True
            return False
        finally:
            self.destroy_subscription(subscription)

    def goToPose(self, pose: PoseStamped, behavior_tree: str = "") -> bool:  # noqa: N802
        """Send a goal and wait until it is accepted; False, with a line in the log, if it is refused."""
        return self.goThroughPoses([pose], behavior_tree)

    def goThroughPoses(self, poses: Sequence[PoseStamped], behavior_tree: str = "") -> bool:  # noqa: N802
        """Send a path, whose poses have to be in one frame; else as :meth:`goToPose`. ``behavior_tree`` is ignored."""
        frames = {pose.header.frame_id or self.frame for pose in poses}
        try:
            if len(frames) != 1:
                raise GoalRefusedError(
                    f"{len(poses)} poses in {len(frames)} frames: must be at least one, in one frame"
                )
            self._present = self
            self.send_goal([pose_of(pose.pose) for pose in poses], frames.pop())
        except DiffbotError as error:
            self.get_logger().error(str(error))
            return False
        return True

    def dock(self, controller: str = "dock_controller") -> bool:
        """Begin to dock where ``docking_node`` sees a dock; False, with a line in the log, if that is refused.

        Drive to a pose from which it is seen first; feedback, end and cancellation are as of :meth:`goToPose`.
        """
        return self._send_in_dock(Pose(0.0, 0.0, 0.0), controller)

    def undock(self, distance: float = 0.7, backward: bool = False, controller: str = "dock_controller") -> bool:
        """Begin to drive out along the dock's axis until ``distance`` [m] before the docked pose.

        Args:
            distance: [m].
            backward: the back of the robot is docked (``dock_backward``).
            controller: the node that docks.
        """
        return self._send_in_dock(pose_on_axis(distance, backward), controller)

    def _send_in_dock(self, pose: Pose, controller: str) -> bool:
        if self._docking is None or self._docking.controller != controller:
            if self._docking is not None:
                self._docking.close(shut_down=False)
            name, namespace = self._names
            self._docking = GoalClient(name, namespace, **self._options | {"controller": controller, "frame": "dock"})
        self._present = self._docking
        try:
            self._docking.send_goal([pose])
        except DiffbotError as error:
            self.get_logger().error(str(error))
            return False
        return True

    def isTaskComplete(self) -> bool:  # noqa: N802
        """Handle messages for at most 0.1 s; True if the newest goal has ended, or there is none."""
        return not self._present.task.id or self._present.wait_for_end(0.1)

    def getFeedback(self) -> Feedback | None:  # noqa: N802
        """Return the newest feedback of the goal, None before the first."""
        return self._present.task.feedback

    def getResult(self) -> TaskResult:  # noqa: N802
        """Return how the newest goal ended: UNKNOWN before its end, or if the controller was restarted."""
        return _RESULTS.get(self._present.task.end, TaskResult.FAILED)

    def getReason(self) -> str:  # noqa: N802
        """Return the end of the newest goal in words, such as ``not reached: hunting: ...``; empty before it."""
        task = self._present.task
        return f"{task.end}: {task.reason}" if task.reason else task.end

    def cancelTask(self) -> bool:  # noqa: N802
        """Cancel the newest goal and wait until the robot is at rest, at most 5 s; see :meth:`GoalClient.cancel`."""
        return self._present.cancel()
