"""Publishers of the node ``ekf``: pose and odometry/filtered."""

from __future__ import annotations

from typing import TYPE_CHECKING

from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry

from diffbot_control.filter.localization import FilterEstimate
from diffbot_control.ros.messages.conversions import odometry_message, pose_message
from diffbot_control.ros.messages.fields import (
    fill_planar_covariance,
    fill_pose,
    fill_twist,
    fill_twist_covariance,
    set_stamp,
)
from diffbot_core.kinematics import Twist, TwistCovariance
from diffbot_core.ros.managed_node import ManagedNode
from diffbot_core.ros.qos import QUEUE
from diffbot_core.shared_parameters import robot_frame

if TYPE_CHECKING:
    from diffbot_control.ros.parameters.ekf import EkfNodeConfig


class EkfPublishers:
    """Publishes estimates while there are subscribers; each message is created once and filled repeatedly."""

    def __init__(self, node: ManagedNode[EkfNodeConfig]) -> None:
        """Create the publishers of ``node``, whose health counts the published messages."""
        config = node.config
        self._sent = node.health.sent
        self._pose = pose_message(config.map_frame)
        self._filtered = odometry_message(config.map_frame, robot_frame(config))
        self._poses = node.create_publisher(PoseWithCovarianceStamped, "pose", QUEUE)
        self._filtered_odometry = node.create_publisher(Odometry, "odometry/filtered", QUEUE)
        for topic in ("pose", "odometry/filtered"):
            node.publisher_watch.watch(topic, "estimate the pose")

    def send_pose(self, estimate: FilterEstimate) -> None:
        """Publish the pose if there is a subscriber."""
        if not self._poses.get_subscription_count():
            return
        set_stamp(self._pose.header.stamp, estimate.stamp)
        fill_pose(self._pose.pose.pose, estimate.pose)
        fill_planar_covariance(self._pose.pose.covariance, estimate.P)
        self._poses.publish(self._pose)
        self._sent["pose"] += 1

    def send_filtered(self, estimate: FilterEstimate, twist: Twist, covariance: TwistCovariance) -> None:
        """Publish the estimate with a twist and the covariance of the twist, if there is a subscriber."""
        if not self._filtered_odometry.get_subscription_count():
            return
        message = self._filtered
        set_stamp(message.header.stamp, estimate.stamp)
        fill_pose(message.pose.pose, estimate.pose)
        fill_planar_covariance(message.pose.covariance, estimate.P)
        fill_twist(message.twist.twist, twist)
        fill_twist_covariance(message.twist.covariance, covariance)
        self._filtered_odometry.publish(message)
        self._sent["odometry/filtered"] += 1
