"""What the plant sends: messages made once and filled again for each step."""

from __future__ import annotations

from typing import Any

from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu, JointState, PointCloud2, PointField

from diffbot_control.ros.frames import odometry_frame, robot_frame
from diffbot_control.ros.messages.conversions import TFMessage, odometry_message, pose_message, transform_message
from diffbot_control.ros.messages.fields import (
    fill_planar_covariance,
    fill_pose,
    fill_twist,
    fill_twist_covariance,
    fill_yaw,
    set_stamp,
)
from diffbot_control.ros.messages.landmark_cloud import LandmarkPoint, fill_landmark_points
from diffbot_control.ros.tf import TF_TOPIC
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist
from diffbot_core.ros.node import QUEUE, DiffbotNode
from diffbot_core.ros.qos import TRANSFORMS
from diffbot_sim.model.simulator import Arrivals, FixReading, HeadingReading, LandmarkReading, World
from diffbot_sim.ros.dock import DockTopics
from diffbot_sim.ros.gyro import GyroTopic
from diffbot_sim.ros.parameters import PlantNodeConfig


class PlantTopics:
    """Publishers of the plant."""

    def __init__(self, node: DiffbotNode[PlantNodeConfig]) -> None:
        """Create the publishers on ``node``, whose health counts what is sent."""
        config = node.config
        self._frames = odometry_frame(config), robot_frame(config)
        self._sent = node.health.sent
        self._odometry = odometry_message(*self._frames)
        self._truth = odometry_message(config.map_frame, robot_frame(config))
        self._fix = pose_message(config.map_frame)
        self._heading = Imu()
        self._heading.header.frame_id = robot_frame(config)
        # REP-145: no angular velocity, no acceleration in it.
        self._heading.angular_velocity_covariance[0] = -1.0
        self._heading.linear_acceleration_covariance[0] = -1.0
        self._heading.orientation_covariance[[0, 4]] = 1e6
        self._cloud = PointCloud2()
        self._cloud.header.frame_id = robot_frame(config)
        self._joints = JointState(name=[config.left_wheel_name, config.right_wheel_name])
        self._clock_message = Clock()
        self._odometries = node.create_publisher(Odometry, "odom", QUEUE)
        self._truths = node.create_publisher(Odometry, "ground_truth", QUEUE)
        self._fixes = node.create_publisher(PoseWithCovarianceStamped, "global_pose", QUEUE)
        self._headings = node.create_publisher(Imu, "heading", QUEUE)
        self._docks = DockTopics(node) if config.world.sensors.detector.detection_rate > 0.0 else None
        self._clouds = node.create_publisher(PointCloud2, "landmarks", QUEUE)
        self._joint_states = node.create_publisher(JointState, "joint_states", QUEUE)
        self._gyro = GyroTopic(node)
        self._clocks = node.create_publisher(Clock, "/clock", QUEUE) if config.owns_time() else None
        self._transforms = None
        if config.publish_tf and TFMessage is None:
            node.get_logger().info("tf2_msgs is not installed: no TF is published")
        elif config.publish_tf:
            self._transforms = node.create_publisher(TFMessage, TF_TOPIC, TRANSFORMS)

    def required(self, fixes: bool) -> list[Any]:
        """Publishers that a filter must subscribe to before the first step; with joint_states it needs no odom.

        Args:
            fixes: True if there are any.
        """
        moving = self._odometries
        if self._joint_states.get_subscription_count() and not self._odometries.get_subscription_count():
            moving = self._joint_states
        return [moving, self._fixes] if fixes else [moving]

    def subscription_counts(self) -> tuple[int, ...]:
        """How many subscribe to each topic that a filter may use."""
        publishers = (self._odometries, self._fixes, self._headings, self._clouds)
        return tuple(publisher.get_subscription_count() for publisher in publishers)

    def publish_truth(self, world: World) -> None:
        """Send only time and true state, which no filter answers."""
        if self._clocks is not None:
            set_stamp(self._clock_message.clock, world.stamp)
            self._clocks.publish(self._clock_message)
        if self._truths.get_subscription_count():
            self._send_odometry(self._truths, self._truth, world.stamp, world.state.pose, world.state.twist)

    def publish(self, world: World, arrivals: Arrivals) -> None:
        """Send all messages of the present step, the odometry last: it is what the filter answers."""
        stamp = world.stamp
        self.publish_truth(world)
        for fix in arrivals.fixes:
            self._send_fix(fix)
        for heading in arrivals.headings:
            self._send_heading(heading)
        if arrivals.landmarks:
            self._send_landmarks(stamp, arrivals.landmarks)
        if self._docks is not None:
            self._docks.publish(world, arrivals.detections)
        self._gyro.publish(world)
        if self._joint_states.get_subscription_count():
            self._send_joint_states(stamp, world)
        in_odom = world.state.odometry
        if self._transforms is not None:
            self._transforms.publish(transform_message(stamp, *self._frames, in_odom))
        odometry = world.odometry()
        fill_planar_covariance(self._odometry.pose.covariance, world.odometry_P)
        fill_twist_covariance(self._odometry.twist.covariance, odometry.covariance)
        self._send_odometry(self._odometries, self._odometry, stamp, in_odom, odometry.twist)
        self._sent["odom"] += 1

    def _send_odometry(self, publisher: Any, message: Odometry, stamp: int, pose: Pose, twist: Twist) -> None:
        set_stamp(message.header.stamp, stamp)
        fill_pose(message.pose.pose, pose)
        fill_twist(message.twist.twist, twist)
        publisher.publish(message)

    def _send_fix(self, fix: FixReading) -> None:
        set_stamp(self._fix.header.stamp, fix.stamp)
        fill_pose(self._fix.pose.pose, fix.pose)
        fill_planar_covariance(self._fix.pose.covariance, fix.R)
        self._fixes.publish(self._fix)
        self._sent["global_pose"] += 1

    def _send_heading(self, heading: HeadingReading) -> None:
        set_stamp(self._heading.header.stamp, heading.stamp)
        fill_yaw(self._heading.orientation, heading.theta)
        self._heading.orientation_covariance[8] = heading.R[0, 0]
        self._headings.publish(self._heading)
        self._sent["heading"] += 1

    def _send_landmarks(self, stamp: int, landmarks: list[LandmarkReading]) -> None:
        set_stamp(self._cloud.header.stamp, stamp)
        points = [LandmarkPoint(one.number, one.range, one.bearing, *one.R.diagonal().tolist()) for one in landmarks]
        fill_landmark_points(self._cloud, points, PointField)
        self._clouds.publish(self._cloud)
        self._sent["landmarks"] += 1

    def _send_joint_states(self, stamp: int, world: World) -> None:
        set_stamp(self._joints.header.stamp, stamp)
        self._joints.position = list(world.state.angles)
        self._joints.velocity = list(world.state.encoder)
        self._joint_states.publish(self._joints)
        self._sent["joint_states"] += 1
