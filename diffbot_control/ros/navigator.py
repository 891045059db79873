"""Send goals and wait until they end, from a Python program.

The methods have the names of BasicNavigator in nav2_simple_commander, but do not need actions: a goal is a message that
is repeated until the controller has accepted it. A program that drives to one goal::

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
from lifecycle_msgs.srv import ChangeState, GetState
from nav_msgs.msg import Path

from diffbot_control.goals import record as goal_record
from diffbot_control.law.docking_axis import pose_on_axis
from diffbot_control.ros.goals.client import LOST, REPEAT_PERIOD, GoalClient, GoalTask, TaskFeedback
from diffbot_control.ros.messages.fields import pose_of
from diffbot_core.errors import BadMessageError, DiffbotError
from diffbot_core.geometry import Pose
from diffbot_core.ros.qos import QUEUE

_STARTUP = {"unconfigured": "configure", "inactive": "activate"}
_SHUTDOWN = {"active": "deactivate", "inactive": "cleanup", "unconfigured": "shutdown"}
"""Transitions by the state of a managed node."""
_SERVICE_TIMEOUT = 10.0
"""[s] longest wait for a service, and for its response"""
_NEAR = 1.0
"""[m] largest distance between the initial pose and the first estimate after it"""


class TaskResult(Enum):
    """Result of a task, with the names of nav2_simple_commander."""

    UNKNOWN = 0
    SUCCEEDED = 1
    CANCELED = 2
    FAILED = 3


_RESULTS = {"": TaskResult.UNKNOWN, LOST: TaskResult.UNKNOWN} | {
    goal_record.REACHED: TaskResult.SUCCEEDED,
    goal_record.CANCELLED: TaskResult.CANCELED,
}


class Navigator(GoalClient):
    """Drives to goals with the methods of BasicNavigator; see :class:`GoalClient` for the arguments."""

    def __init__(self, node_name: str = "navigator", namespace: str = "", **options: Any) -> None:
        """Create the node and the publisher of ``initialpose``; ``options`` are passed to :class:`GoalClient`."""
        super().__init__(node_name, namespace, **options)
        self._dock_names = f"{node_name}_dock", namespace
        self._options = {**options, "context": self.context}
        self._docking: GoalClient | None = None
        """client of the controller that docks, created when it is needed"""
        self._newest_client: GoalClient = self
        """client that sent the newest goal"""
        self._waypoints: list[PoseStamped] = []
        """poses of followWaypoints that are still to be sent"""
        self._waypoint = 0
        logger = self.get_logger()
        self.debug, self.info, self.warn, self.error = logger.debug, logger.info, logger.warning, logger.error
        self._initial_poses = self.create_publisher(PoseWithCovarianceStamped, "initialpose", QUEUE)

    def destroyNode(self) -> None:  # noqa: N802 - the names of BasicNavigator, here and below
        """Destroy the node; the context is not shut down."""
        if self._docking is not None:
            self._docking.close(shut_down=False)
        self.close(shut_down=False)

    def waitUntilReady(self, timeout: float = math.inf) -> bool:  # noqa: N802
        """Wait until the controller can receive goals; return False if it cannot within ``timeout`` [s]."""
        return self.wait_until_ready(timeout)

    def waitUntilNav2Active(self, navigator: str = "", localizer: str = "") -> None:  # noqa: N802
        """Wait until the controller can receive goals, without a timeout; the arguments are ignored."""
        self.wait_until_ready()

    def setInitialPose(  # noqa: N802
        self, initial_pose: PoseStamped, sigma_xy: float = 0.1, sigma_yaw: float = 0.1, timeout: float = 10.0
    ) -> bool:
        """Initialise the filter and wait until it publishes a pose within 1 m of ``initial_pose``.

        Args:
            initial_pose: pose in the frame of the map.
            sigma_xy: [m] standard deviation in x and in y.
            sigma_yaw: [rad] standard deviation of the heading.
            timeout: [s] time after which the method gives up and returns False.
        """
        message = PoseWithCovarianceStamped(header=initial_pose.header)
        message.header.frame_id = message.header.frame_id or self.frame
        message.pose.pose = initial_pose.pose
        message.pose.covariance[0] = message.pose.covariance[7] = sigma_xy**2
        message.pose.covariance[35] = sigma_yaw**2
        initial, received = pose_of(initial_pose.pose), list[Pose]()

        def is_initialised() -> bool:
            return any(math.hypot(pose.x - initial.x, pose.y - initial.y) <= _NEAR for pose in received)

        subscription = self.create_subscription(
            PoseWithCovarianceStamped, "pose", lambda estimate: received.append(pose_of(estimate.pose.pose)), QUEUE
        )
        deadline = time.monotonic() + timeout
        try:
            while (left := deadline - time.monotonic()) > 0.0 and not self.is_stopped():
                # Repeat the message, because the filter may not have discovered this publisher yet.
                if self.spin_until(self._initial_poses.get_subscription_count, left):
                    received.clear()
                    self._initial_poses.publish(message)
                    if self.spin_until(is_initialised, min(left, REPEAT_PERIOD)):
                        return True
            return False
        finally:
            self.destroy_subscription(subscription)

    def goToPose(self, pose: PoseStamped, behavior_tree: str = "") -> bool:  # noqa: N802
        """Send a goal and wait until it is accepted; if it is refused, log the reason and return False."""
        return self.goThroughPoses([pose], behavior_tree)

    def goThroughPoses(self, poses: Sequence[PoseStamped], behavior_tree: str = "") -> bool:  # noqa: N802
        """Send a path like :meth:`goToPose`; all poses must be in one frame, and ``behavior_tree`` is ignored."""
        return self._send_poses([pose.header.frame_id or self.frame for pose in poses], poses)

    def followPath(self, path: Path, controller_id: str = "", goal_checker_id: str = "") -> bool:  # noqa: N802
        """Send a path like :meth:`goThroughPoses`; the ids are ignored."""
        frame = path.header.frame_id or self.frame
        return self._send_poses([pose.header.frame_id or frame for pose in path.poses], path.poses)

    def followWaypoints(self, poses: Sequence[PoseStamped]) -> bool:  # noqa: N802
        """Drive to each pose in turn, within the tolerances; a pose that is not reached ends the task.

        Call :meth:`isTaskComplete` repeatedly: it sends the next pose.
        """
        if not self.goThroughPoses(poses[:1]):
            return False
        self._waypoints = list(poses[1:])
        return True

    def _next_waypoint(self) -> bool:
        """Send the next waypoint if the previous one was reached; return True if it is accepted."""
        if not self._waypoints or self.getResult() != TaskResult.SUCCEEDED:
            return False
        (pose, *later), number = self._waypoints, self._waypoint + 1
        # A program must not hang because the controller has ended between two waypoints.
        is_accepted = self._send_poses([pose.header.frame_id or self.frame], [pose], _SERVICE_TIMEOUT)
        if not is_accepted:
            self.task = GoalTask(self.task.id)
            self.task.close(goal_record.REFUSED, f"waypoint {number}, see the log")
        self._waypoints, self._waypoint = later if is_accepted else [], number
        return is_accepted

    def _send_poses(self, names: list[str], poses: Sequence[PoseStamped], timeout: float = math.inf) -> bool:
        """Send poses; ``names`` are their frames, ``timeout`` [s] is for the answer."""
        if (number := len(set(names))) != 1:
            self.error(f"{len(poses)} poses in {number} frames: give at least one pose, and all poses in one frame")
            return False
        try:
            return self._send(self, [pose_of(pose.pose) for pose in poses], names[0], timeout)
        except BadMessageError as error:
            self.error(str(error))
            return False

    def _send(self, client: GoalClient, poses: list[Pose], frame: str = "", timeout: float = math.inf) -> bool:
        """Send a goal with one of the two clients; return True if it is accepted, otherwise log the reason."""
        try:
            client.send_goal(poses, frame, timeout)
        except DiffbotError as error:
            self.error(str(error))
            return False
        self._newest_client, self._waypoints, self._waypoint = client, [], 0
        return True

    def dock(self, controller: str = "dock_controller") -> bool:
        """Start to dock where ``docking_node`` detects a dock; if this is refused, log the reason and return False.

        The robot must be at a pose from which it detects the dock. Feedback, result and cancellation work as after
        :meth:`goToPose`.
        """
        return self._send_in_dock(Pose(0.0, 0.0, 0.0), controller)

    def undock(self, distance: float = 0.7, backward: bool = False, controller: str = "dock_controller") -> bool:
        """Start to leave the dock along its axis.

        Args:
            distance: [m] distance from the docked pose at which the robot stops.
            backward: True if the robot docks with its back (``dock_backward``).
            controller: name of the controller that docks.
        """
        return self._send_in_dock(pose_on_axis(distance, backward), controller)

    def _send_in_dock(self, pose: Pose, controller: str) -> bool:
        if self._docking is None or self._docking.controller != controller:
            if self._docking is not None:
                self._docking.close(shut_down=False)
            own = {"controller": controller, "frame": "dock", "prefix": "dock/"}
            self._docking = GoalClient(*self._dock_names, **self._options | own)
        return self._send(self._docking, [pose])

    def isTaskComplete(self, task: Any = None) -> bool:  # noqa: N802
        """Handle messages for at most 0.1 s; return True if the newest task has ended, or if there is no task.

        ``task`` is ignored, here and below; programs written for newer versions of Nav2 pass it.
        """
        return not self._newest_client.task.id or (self._newest_client.wait_for_end(0.1) and not self._next_waypoint())

    def getFeedback(self, task: Any = None) -> TaskFeedback | None:  # noqa: N802
        """Return the newest feedback of the goal; None before the first feedback."""
        feedback = self._newest_client.task.feedback
        return feedback and feedback._replace(current_waypoint=self._waypoint)

    def getResult(self, task: Any = None) -> TaskResult:  # noqa: N802
        """Return the result of the newest goal: UNKNOWN before its end, or if the controller is lost."""
        return _RESULTS.get(self._newest_client.task.end, TaskResult.FAILED)

    def getReason(self) -> str:  # noqa: N802
        """Return how the newest goal ended, such as ``not reached: no progress ...``; empty before its end."""
        return self._newest_client.task.text

    def cancelTask(self) -> bool:  # noqa: N802
        """Cancel the newest goal and wait at most 5 s until the robot is at rest; see :meth:`GoalClient.cancel`."""
        self._waypoints = []
        return self._newest_client.cancel()

    def lifecycleStartup(self) -> bool:  # noqa: N802
        """Configure and activate the ekf, if there is one, and the controller; return True if both are active."""
        return self._change_states(("ekf", self.controller), _STARTUP, "active")

    def lifecycleShutdown(self) -> bool:  # noqa: N802
        """Shut down the controller, which stops the robot, and the ekf; return True if both are finalized."""
        return self._change_states((self.controller, "ekf"), _SHUTDOWN, "finalized")

    def _change_states(self, names: tuple[str, ...], transitions: dict[str, str], goal: str) -> bool:
        """Request transitions until none applies to a node; return True if all nodes are in the state ``goal``.

        The ekf may be missing, but not the controller.
        """
        labels: dict[str, str] = {}
        for name in names:
            while (answer := self._call(GetState, f"{name}/get_state", GetState.Request())) is not None:
                label = answer.current_state.label
                if label not in transitions:
                    labels[name] = label
                    break
                request = ChangeState.Request()
                request.transition.label = transitions[label]
                changed = self._call(ChangeState, f"{name}/change_state", request)
                if changed is None or not changed.success:
                    self.error(f"{name}: the transition {transitions[label]} has failed: see the log of the node")
                    return False
        if self.controller not in labels:
            self.error(f"no answer from {self.controller}: does it run, with the same ROS_DOMAIN_ID?")
        return labels.get(self.controller) == labels.get("ekf", goal) == goal

    def _call(self, kind: Any, name: str, request: Any) -> Any:
        """Call a service; return None if it is missing or does not respond."""
        client = self.create_client(kind, name)
        try:
            if self.spin_until(client.service_is_ready, _SERVICE_TIMEOUT):
                future = client.call_async(request)
                if self.spin_until(future.done, _SERVICE_TIMEOUT):
                    return future.result()
            return None
        finally:
            self.destroy_client(client)
