"""What the plant sends of a dock: ``detected_dock_pose`` in the frame of the robot, and ``dock_contact``."""

from __future__ import annotations

from geometry_msgs.msg import PoseWithCovarianceStamped
from std_msgs.msg import Bool

from diffbot_control.ros.frames import robot_frame
from diffbot_control.ros.messages.conversions import pose_message
from diffbot_control.ros.messages.fields import fill_planar_covariance, fill_pose, set_stamp
from diffbot_core.ros.node import QUEUE, DiffbotNode
from diffbot_sim.model.simulator import DetectionReading, World
from diffbot_sim.ros.parameters import PlantNodeConfig


class DockTopics:
    """Publishers of the detector and of the contact switch."""

    def __init__(self, node: DiffbotNode[PlantNodeConfig]) -> None:
        """Create them on ``node``, whose health counts what is sent."""
        self._sent = node.health.sent
        self._detection = pose_message(robot_frame(node.config))
        self._detections = node.create_publisher(PoseWithCovarianceStamped, "detected_dock_pose", QUEUE)
        self._contacts = node.create_publisher(Bool, "dock_contact", QUEUE)

    def publish(self, world: World, detections: list[DetectionReading]) -> None:
        """Send what arrives at the present step."""
        for one in detections:
            set_stamp(self._detection.header.stamp, one.stamp)
            fill_pose(self._detection.pose.pose, one.pose)
            fill_planar_covariance(self._detection.pose.covariance, one.R)
            self._detections.publish(self._detection)
            self._sent["detected_dock_pose"] += 1
        self._contacts.publish(Bool(data=world.touches_dock))
