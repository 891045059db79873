"""CDR without ROS, held to ROS's own serialiser; not to its bytes, since it leaves the padding uninitialised."""

import numpy as np
import pytest
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from rclpy.serialization import deserialize_message, serialize_message
from std_msgs.msg import Float64MultiArray, MultiArrayDimension

from diffbot_bag.encoding import ODOMETRY, POSE, Encoder, NumbersMessage, decode_numbers_message

STAMP = 1_248_446_190_755_000_001
FRAMES = ["", "a", "map", "odom", "robot/base_link", "Ω"]


def ros_odometry(frame, child, numbers):
    message = Odometry()
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(STAMP, 10**9)
    message.header.frame_id, message.child_frame_id = frame, child
    fill_pose(message.pose, numbers)
    linear, angular = message.twist.twist.linear, message.twist.twist.angular
    linear.x, linear.y, linear.z, angular.x, angular.y, angular.z = numbers[43:49]
    message.twist.covariance[:] = numbers[49:]
    return message


def ros_pose(frame, numbers):
    message = PoseWithCovarianceStamped()
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(STAMP, 10**9)
    message.header.frame_id = frame
    fill_pose(message.pose, numbers)
    return message


def fill_pose(message, numbers):
    p, q = message.pose.position, message.pose.orientation
    p.x, p.y, p.z, q.x, q.y, q.z, q.w = numbers[:7]
    message.covariance[:] = numbers[7:43]


@pytest.mark.parametrize("frame", FRAMES)
@pytest.mark.parametrize("child", FRAMES)
def test_ros_reads_the_odometry(frame, child):
    numbers = [float(one) for one in range(1, 86)]
    message = NumbersMessage(ODOMETRY, frame, child)
    message.numbers[:] = numbers
    expected = ros_odometry(frame, child, numbers)
    assert deserialize_message(message.encode(STAMP), Odometry) == expected
    assert len(message.encode(STAMP)) == len(serialize_message(expected))


@pytest.mark.parametrize("frame", FRAMES)
def test_ros_reads_the_pose(frame):
    numbers = [float(one) for one in range(1, 44)]
    message = NumbersMessage(POSE, frame)
    message.numbers[:] = numbers
    expected = ros_pose(frame, numbers)
    assert deserialize_message(message.encode(STAMP), PoseWithCovarianceStamped) == expected
    assert len(message.encode(STAMP)) == len(serialize_message(expected))


@pytest.mark.parametrize("frame", FRAMES)
def test_short_cut_has_the_bytes_of_the_library(frame):
    message = NumbersMessage(ODOMETRY, frame, "base_link")
    message.numbers[7:] = range(7, 85)
    plain = {
        "header": {"stamp": {"sec": STAMP // 10**9, "nanosec": STAMP % 10**9}, "frame_id": frame},
        "child_frame_id": "base_link",
        "pose": {"pose": {"orientation": {"w": 1.0}}, "covariance": [float(one) for one in range(7, 43)]},
        "twist": {
            "twist": {"linear": {"x": 43.0, "y": 44.0, "z": 45.0}, "angular": {"x": 46.0, "y": 47.0, "z": 48.0}},
            "covariance": [float(one) for one in range(49, 85)],
        },
    }
    assert message.encode(STAMP) == Encoder().encode(ODOMETRY, plain)


def test_views_are_the_fields_of_their_names():
    message = NumbersMessage(ODOMETRY, "map", "base_link")
    message.position[:] = 1.0, 2.0, 3.0
    message.orientation[:] = 0.1, 0.2, 0.3, 0.4
    message.pose_covariance[35] = 5.0
    message.twist[[0, 5]] = 6.0, 7.0
    message.twist_covariance[0] = 8.0
    received = deserialize_message(message.encode(STAMP), Odometry)
    assert received.pose.pose.position.z == 3.0
    assert received.pose.pose.orientation.w == 0.4
    assert received.pose.covariance[35] == 5.0
    assert (received.twist.twist.linear.x, received.twist.twist.angular.z) == (6.0, 7.0)
    assert received.twist.covariance[0] == 8.0


def flat(message):
    p, q = message.pose.pose.position, message.pose.pose.orientation
    numbers = [p.x, p.y, p.z, q.x, q.y, q.z, q.w, *message.pose.covariance]
    if hasattr(message, "twist"):
        linear, angular = message.twist.twist.linear, message.twist.twist.angular
        numbers += [linear.x, linear.y, linear.z, angular.x, angular.y, angular.z, *message.twist.covariance]
    return numbers


@pytest.mark.parametrize("frame", FRAMES)
def test_bytes_of_ros_are_decoded(frame):
    numbers = np.random.default_rng(3).normal(size=85).tolist()
    odometry = decode_numbers_message(ODOMETRY, serialize_message(ros_odometry(frame, "base", numbers)))
    assert flat(odometry) == numbers
    assert (odometry.header.frame_id, odometry.child_frame_id) == (frame, "base")
    assert (odometry.header.stamp.sec, odometry.header.stamp.nanosec) == divmod(STAMP, 10**9)
    pose = decode_numbers_message(POSE, serialize_message(ros_pose(frame, numbers[:43])))
    assert flat(pose) == numbers[:43]


def test_other_types_byte_orders_and_sizes_are_left_to_the_library():
    data = serialize_message(ros_pose("map", [0.0] * 43))
    assert decode_numbers_message("sensor_msgs/msg/Imu", data) is None
    assert decode_numbers_message(POSE, b"\0\0\0\0" + data[4:]) is None
    assert decode_numbers_message(POSE, data + bytes(8)) is None
    assert decode_numbers_message(ODOMETRY, data) is None
    for size in range(len(data)):
        assert decode_numbers_message(POSE, data[:size]) is None
    huge = bytearray(data)
    huge[12:16] = b"\xff\xff\xff\xff"
    assert decode_numbers_message(POSE, bytes(huge)) is None


def test_any_type_is_encoded_as_ros_does():
    message = Float64MultiArray(data=[1.5, -2.0])
    message.layout.dim = [MultiArrayDimension(label="nis", size=1, stride=2)]
    plain = {"data": [1.5, -2.0], "layout": {"dim": [{"label": "nis", "size": 1, "stride": 2}]}}
    data = Encoder().encode("std_msgs/msg/Float64MultiArray", plain)
    assert deserialize_message(data, Float64MultiArray) == message
