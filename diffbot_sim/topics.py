"""Publishers of the plant. Each message object is created once and filled again at each step."""

from __future__ import annotations

from typing import Any

from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu, JointState, PointCloud2, PointField
from std_msgs.msg import Bool

from diffbot_control.filter.measurement import GyroSample
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
from diffbot_core.ros.node import DiffbotNode
from diffbot_core.ros.qos import QUEUE, TRANSFORMS
from diffbot_core.shared_parameters import odometry_frame, robot_frame
from diffbot_sim.config import WorldConfig
from diffbot_sim.parameters import WALL, PlantNodeConfig
from diffbot_sim.world import Arrivals, HeadingReading, LandmarkReading, PoseReading, World


class PlantTopics:
    """Publishers of the plant."""

    def __init__(self, node: DiffbotNode[PlantNodeConfig]) -> None:
        """Create the publishers on ``node``. The node's health counts the messages."""
        config, robot = node.config, robot_frame(node.config)
        self._frames = odometry_frame(config), robot
        self._health = node.health
        self._odometry, self._truth = odometry_message(*self._frames), odometry_message(config.map_frame, robot)
        self._fix, self._detection = pose_message(config.map_frame), pose_message(robot)
        self._heading, self._imu, self._cloud = Imu(), Imu(), PointCloud2()
        for message in (self._heading, self._imu, self._cloud):
            message.header.frame_id = robot
        # REP-145: -1 in the first element of a covariance means that the message does not contain the quantity.
        self._heading.angular_velocity_covariance[0] = self._imu.orientation_covariance[0] = -1.0
        self._heading.linear_acceleration_covariance[0] = self._imu.linear_acceleration_covariance[0] = -1.0
        self._heading.orientation_covariance[[0, 4]] = self._imu.angular_velocity_covariance[[0, 4]] = 1e6
        self._joints = JointState(name=[config.left_wheel_name, config.right_wheel_name])
        self._clock_message = Clock()

        def publisher(kind: Any, topic: str) -> Any:
            return node.create_publisher(kind, topic, QUEUE)

        self._odometries, self._truths = publisher(Odometry, "odom"), publisher(Odometry, "ground_truth")
        self._fixes, self._headings = publisher(PoseWithCovarianceStamped, "global_pose"), publisher(Imu, "heading")
        self._clouds, self._imus = publisher(PointCloud2, "landmarks"), publisher(Imu, "imu")
        self._joint_states = publisher(JointState, "joint_states")
        self._create_publisher = publisher
        self._detections = self._contacts = None
        self._open_detector(config.world)
        self._clocks = publisher(Clock, "/clock") if config.clock != WALL else None
        self._transforms = None
        if config.publish_tf and TFMessage is None:
            node.get_logger().info("TF is not published, since tf2_msgs is not installed")
        elif config.publish_tf:
            self._transforms = node.create_publisher(TFMessage, TF_TOPIC, TRANSFORMS)

    def _open_detector(self, config: WorldConfig) -> None:
        """Create the publishers of a detector when its rate is not 0, which may change at run time."""
        if self._contacts is None and config.sensors.detector.detection_rate > 0.0:
            self._detections = self._create_publisher(PoseWithCovarianceStamped, "detected_dock_pose")
            self._contacts = self._create_publisher(Bool, "dock_contact")

    def required(self, fixes: bool) -> list[Any]:
        """Return the publishers that need a subscription before the first step.

        A filter may subscribe to joint_states instead of odom.

        Args:
            fixes: True if the plant sends fixes.
        """
        wheels = self._odometries
        if self._joint_states.get_subscription_count() and not self._odometries.get_subscription_count():
            wheels = self._joint_states
        return [wheels, self._fixes] if fixes else [wheels]

    def subscription_counts(self) -> tuple[int, ...]:
        """Return the number of subscriptions to each topic that a filter may use."""
        publishers = (self._odometries, self._fixes, self._headings, self._clouds)
        return tuple(publisher.get_subscription_count() for publisher in publishers)

    def publish_truth(self, world: World) -> None:
        """Send only time and true state, which filters do not use."""
        if self._clocks is not None:
            set_stamp(self._clock_message.clock, world.stamp)
            self._clocks.publish(self._clock_message)
        if self._truths.get_subscription_count():
            self._send_odometry(self._truths, self._truth, world.stamp, world.state.pose, world.state.twist)

    def publish(self, world: World, arrivals: Arrivals) -> None:
        """Send all messages of the present step. The odometry is the last message, since the filter answers it."""
        stamp, in_odom, odometry, rate = world.stamp, world.state.odometry, world.odometry(), world.turn_rate()
        self._open_detector(world.config)
        self.publish_truth(world)
        for fix in arrivals.fixes:
            self._send_pose("global_pose", self._fixes, self._fix, fix)
        for one in arrivals.headings:
            self._send_heading(one)
        if arrivals.landmarks:
            self._send_landmarks(stamp, arrivals.landmarks)
        for detection in arrivals.detections:
            self._send_pose("detected_dock_pose", self._detections, self._detection, detection)
        if self._contacts is not None:
            self._contacts.publish(Bool(data=world.touches_dock_at(world.state.pose)))
        if rate is not None:
            self._send_rate(rate)
        if self._joint_states.get_subscription_count():
            self._send_joint_states(stamp, world)
        if self._transforms is not None:
            self._transforms.publish(transform_message(stamp, *self._frames, in_odom))
        fill_planar_covariance(self._odometry.pose.covariance, world.odometry_P)
        fill_twist_covariance(self._odometry.twist.covariance, odometry.covariance)
        self._send_odometry(self._odometries, self._odometry, stamp, in_odom, odometry.twist)
        self._health.sent["odom"] += 1

    def _send_odometry(self, publisher: Any, message: Odometry, stamp: int, pose: Pose, twist: Twist) -> None:
        set_stamp(message.header.stamp, stamp)
        fill_pose(message.pose.pose, pose)
        fill_twist(message.twist.twist, twist)
        publisher.publish(message)

    def _send_pose(self, topic: str, publisher: Any, message: Any, reading: PoseReading) -> None:
        set_stamp(message.header.stamp, reading.stamp)
        fill_pose(message.pose.pose, reading.pose)
        fill_planar_covariance(message.pose.covariance, reading.R)
        publisher.publish(message)
        self._health.sent[topic] += 1

    def _send_heading(self, reading: HeadingReading) -> None:
        set_stamp(self._heading.header.stamp, reading.stamp)
        fill_yaw(self._heading.orientation, reading.theta)
        self._heading.orientation_covariance[8] = reading.R[0, 0]
        self._headings.publish(self._heading)
        self._health.sent["heading"] += 1

    def _send_rate(self, reading: GyroSample) -> None:
        set_stamp(self._imu.header.stamp, reading.stamp)
        self._imu.angular_velocity.z = reading.rate
        self._imu.angular_velocity_covariance[8] = reading.variance
        self._imus.publish(self._imu)
        self._health.sent["imu"] += 1

    def _send_landmarks(self, stamp: int, landmarks: list[LandmarkReading]) -> None:
        set_stamp(self._cloud.header.stamp, stamp)
        points = [LandmarkPoint(one.number, one.range, one.bearing, *one.R.diagonal().tolist()) for one in landmarks]
        fill_landmark_points(self._cloud, points, PointField)
        self._clouds.publish(self._cloud)
        self._health.sent["landmarks"] += 1

    def _send_joint_states(self, stamp: int, world: World) -> None:
        set_stamp(self._joints.header.stamp, stamp)
        self._joints.position = list(world.state.angles)
        self._joints.velocity = list(world.state.encoder)
        self._joint_states.publish(self._joints)
        self._health.sent["joint_states"] += 1
