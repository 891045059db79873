"""Reading a message from its bytes gives what rclpy's own deserialisation gives."""

import random

import hypothesis.strategies as st
import pytest
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from hypothesis import given
from nav_msgs.msg import Odometry, Path
from rclpy.serialization import serialize_message

from diffbot_control.ros.messages.conversions import path_from, pose_from, poses_along
from diffbot_control.ros.messages.fields import pose_of
from diffbot_control.ros.messages.raw import read_odometry, read_path, read_pose
from diffbot_control.ros.sensors.fixes import fix_from
from diffbot_control.ros.sensors.odometry import odometry_from
from diffbot_control.ros.transforms import NO_TRANSFORMS
from diffbot_core.cdr import OdometryFields, PoseStampedFields
from diffbot_core.errors import BadMessageError

FRAMES = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=12)
"""All alignments, and characters of several bytes."""


def odometry(seed, frame="odom", child_frame="base_link"):
    draw = random.Random(seed).uniform
    message = Odometry(child_frame_id=child_frame)
    message.header.frame_id = frame
    message.header.stamp.sec, message.header.stamp.nanosec = -5, 999_999_999
    for part in (message.pose.pose.position, message.twist.twist.linear, message.twist.twist.angular):
        part.x, part.y, part.z = draw(-9, 9), draw(-9, 9), draw(-9, 9)
    message.pose.pose.orientation.z, message.pose.pose.orientation.w = 0.6, -0.8
    message.pose.covariance[[0, 7, 35]] = 0.04, 0.09, 0.01
    message.twist.covariance[:] = [draw(-1, 1) for _ in range(36)]
    message.twist.covariance[[0, 5, 30, 35]] = 0.25, 0.01, 0.01, 0.04
    return message


@given(FRAMES, FRAMES)
def test_fields_of_an_odometry_and_a_pose_are_those_of_the_message(frame, child_frame):
    message = odometry(len(frame), frame, child_frame)
    found = read_odometry(serialize_message(message))
    assert isinstance(found, OdometryFields)
    assert found.child_frame_id == child_frame
    assert odometry_from(found, child_frame) == odometry_from(message, child_frame)
    assert pose_of(found.pose.pose) == pose_of(message.pose.pose)
    assert list(found.twist.covariance) == message.twist.covariance.tolist()
    stamped = PoseWithCovarianceStamped(header=message.header, pose=message.pose)
    found = read_pose(serialize_message(stamped))
    assert isinstance(found, PoseStampedFields)
    assert pose_from(found, frame, "") == pose_from(stamped, frame, "")
    one, same = fix_from(found, frame), fix_from(stamped, frame)
    assert (one.stamp, one.pose, one.R.tolist()) == (same.stamp, same.pose, same.R.tolist())
    assert list(found.pose.covariance) == stamped.pose.covariance.tolist()


@pytest.mark.parametrize(("read", "message_type"), [(read_pose, PoseWithCovarianceStamped), (read_odometry, Odometry)])
def test_bytes_that_are_no_message_are_a_bad_message_wherever_they_end(read, message_type):
    data = serialize_message(message_type())
    for end in range(4, len(data) - 8):
        with pytest.raises(BadMessageError, match="cannot be read"):
            read(data[:end])


def path(frame="map", frames=("map", "", "m", "mäp", "robot1/map")):
    message = Path()
    message.header.frame_id, message.header.stamp.sec = frame, 7
    draw = random.Random(3).uniform
    for index in range(25):
        pose = PoseStamped()
        pose.header.frame_id, pose.header.stamp.nanosec = frames[index % len(frames)], index
        pose.pose.position.x, pose.pose.position.y, pose.pose.position.z = draw(-9, 9), draw(-9, 9), draw(-9, 9)
        pose.pose.orientation.z, pose.pose.orientation.w = 0.6, -0.8
        message.poses.append(pose)
    return message


def fields(message):
    """The numbers and texts of a PoseStamped."""
    header, p, q = message.header, message.pose.position, message.pose.orientation
    return (header.stamp.sec, header.stamp.nanosec, header.frame_id, p.x, p.y, p.z, q.x, q.y, q.z, q.w)


@pytest.mark.parametrize("frame", ["", "m", "ma", "map"])
def test_a_path_read_pose_by_pose_is_that_of_the_message(frame):
    message = path(frame)
    found = read_path(serialize_message(message))
    assert (found.header.frame_id, found.header.stamp.sec, found.length) == (frame, 7, 25)
    assert [fields(one) for one in found.poses] == [fields(one) for one in message.poses]


def test_a_path_has_max_path_poses_at_most_whatever_length_it_claims():
    message = path(frames=("",))
    assert len(path_from(message, "map", max_poses=25)) == 25
    with pytest.raises(BadMessageError, match="25 poses, max_path_poses = 24"):
        path_from(message, "map", max_poses=24)
    data = bytearray(serialize_message(Path(header=message.header)))
    data[20:24] = b"\xff" * 4
    with pytest.raises(BadMessageError, match=r"path too long.*4294967295 poses, max_path_poses = 100"):
        poses_along(read_path(bytes(data)), "map", NO_TRANSFORMS, 100)
