"""Reading a message from its bytes gives what rclpy's own deserialisation gives."""

import random
import struct

import pytest
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from rclpy.serialization import serialize_message

from diffbot_control.ros.message_bytes import OdometryFields, PoseStampedFields, read_odometry, read_pose
from diffbot_control.ros.message_fields import fill_pose, pose_in_message, pose_of
from diffbot_control.ros.messages import pose_from
from diffbot_control.ros.sensor_messages import fix_from, odometry_from
from diffbot_core.errors import BadMessageError
from diffbot_core.geometry import Pose


def odometry(seed=1, frame="odom", child_frame="base_link"):
    draw = random.Random(seed).uniform
    message = Odometry(child_frame_id=child_frame)
    message.header.frame_id = frame
    message.header.stamp.sec, message.header.stamp.nanosec = -5, 999_999_999
    for part in (message.pose.pose.position, message.twist.twist.linear, message.twist.twist.angular):
        part.x, part.y, part.z = draw(-9, 9), draw(-9, 9), draw(-9, 9)
    message.pose.pose.orientation.z, message.pose.pose.orientation.w = 0.6, -0.8
    message.twist.covariance[:] = [draw(-1, 1) for _ in range(36)]
    message.twist.covariance[[0, 5, 30, 35]] = 0.25, 0.01, 0.01, 0.04
    return message


# All four alignments of both texts, and characters of several bytes.
@pytest.mark.parametrize("frame", ["", "o", "odom", "robot1/odom", "ödom"])
@pytest.mark.parametrize("child_frame", ["", "b", "ba", "bas", "base", "Fuß/base_link"])
def test_fields_are_those_of_the_message(frame, child_frame):
    message = odometry(len(frame), frame, child_frame)
    found = read_odometry(serialize_message(message))
    assert isinstance(found, OdometryFields)
    assert found.child_frame_id == child_frame
    assert odometry_from(found, child_frame) == odometry_from(message, child_frame)
    assert pose_of(found.pose.pose) == pose_of(message.pose.pose)
    for part in ("linear", "angular"):
        mine, other = getattr(found.twist.twist, part), getattr(message.twist.twist, part)
        assert tuple(mine) == (other.x, other.y, other.z)
    assert list(found.twist.covariance) == message.twist.covariance.tolist()
    assert list(found.pose.covariance) == message.pose.covariance.tolist()


def big_endian(message):
    """Encode a message by hand, most significant byte first."""
    stamp, pose, twist = message.header.stamp, message.pose, message.twist
    data = struct.pack(">iI", stamp.sec, stamp.nanosec)
    for text in (message.header.frame_id, message.child_frame_id):
        data += bytes(-len(data) % 4)
        data += struct.pack(">I", len(text) + 1) + text.encode() + b"\0"
    data += bytes(-len(data) % 8)
    p, q = pose.pose.position, pose.pose.orientation
    numbers = [p.x, p.y, p.z, q.x, q.y, q.z, q.w, *pose.covariance]
    for part in (twist.twist.linear, twist.twist.angular):
        numbers += [part.x, part.y, part.z]
    return b"\0\0\0\0" + data + struct.pack(">85d", *numbers, *twist.covariance)


def test_another_byte_order_is_left_to_rclpy():
    message = odometry()
    found = read_odometry(big_endian(message))
    assert found == message
    assert isinstance(found, Odometry)


def test_a_wrong_frame_is_refused_as_in_a_message():
    found = read_odometry(serialize_message(odometry(child_frame="camera")))
    with pytest.raises(BadMessageError, match="wrong child_frame_id"):
        odometry_from(found, "base_link")


@pytest.mark.parametrize("frame", ["", "m", "ma", "map", "Straße/map"])
def test_a_pose_is_that_of_the_message(frame):
    whole = odometry(len(frame))
    whole.pose.covariance[[0, 7, 35]] = 0.04, 0.09, 0.01
    message = PoseWithCovarianceStamped(header=whole.header, pose=whole.pose)
    message.header.frame_id = frame
    found = read_pose(serialize_message(message))
    assert isinstance(found, PoseStampedFields)
    assert pose_from(found, frame, "") == pose_from(message, frame, "")
    (stamp, pose, R), (same_stamp, same_pose, same_R) = fix_from(found, frame)[:3], fix_from(message, frame)[:3]
    assert (stamp, pose, R.tolist()) == (same_stamp, same_pose, same_R.tolist())
    assert list(found.pose.covariance) == message.pose.covariance.tolist()


def test_bytes_that_are_no_message_are_left_to_rclpy():
    data = serialize_message(PoseWithCovarianceStamped())
    with pytest.raises(Exception, match="deserialize"):
        read_pose(data[:-8])


def test_a_pose_handed_over_is_the_one_that_a_message_carries():
    message, draw, changed = PoseWithCovarianceStamped(), random.Random(3).uniform, 0
    for _ in range(300):
        pose = Pose(draw(-9, 9), draw(-9, 9), draw(-9, 9))
        fill_pose(message.pose.pose, pose)
        assert pose_in_message(pose) == pose_of(message.pose.pose)
        changed += pose_in_message(pose) != pose
    assert changed > 30  # the yaw of a quaternion is another number
