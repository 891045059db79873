"""CDR without ROS, held to ROS's own serialiser; not to its bytes, since it leaves the padding uninitialised."""

import numpy as np
from geometry_msgs.msg import PoseWithCovarianceStamped
from hypothesis import given
from hypothesis import strategies as st
from nav_msgs.msg import Odometry
from rclpy.serialization import deserialize_message, serialize_message

from diffbot_bag.bag.encoding import ODOMETRY, POSE, NumbersMessage, decode_numbers_message

FRAMES = st.text(st.characters(exclude_categories=("Cs", "Cc")), max_size=9)
NUMBERS = np.random.default_rng(3).normal(size=85)


def fill(kind, stamp, frame, child=""):
    """A message of ROS, and the same numbers in the order of its definition."""
    message = kind()
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)
    message.header.frame_id = frame
    p, q = message.pose.pose.position, message.pose.pose.orientation
    p.x, p.y, p.z, q.x, q.y, q.z, q.w = NUMBERS[:7]
    message.pose.covariance[:] = NUMBERS[7:43]
    if kind is Odometry:
        message.child_frame_id = child
        linear, angular = message.twist.twist.linear, message.twist.twist.angular
        linear.x, linear.y, linear.z, angular.x, angular.y, angular.z = NUMBERS[43:49]
        message.twist.covariance[:] = NUMBERS[49:]
    return message


@given(st.integers(0, 2**31 * 10**9 - 1), FRAMES, FRAMES)
def test_ros_reads_what_is_encoded_and_the_other_way_round(stamp, frame, child):
    for name, kind, frames in ((ODOMETRY, Odometry, (frame, child)), (POSE, PoseWithCovarianceStamped, (frame,))):
        theirs = fill(kind, stamp, *frames)
        ours = NumbersMessage(name, *frames)
        ours.numbers[:] = NUMBERS[: len(ours.numbers)]
        data = ours.encode(stamp)
        assert deserialize_message(data, kind) == theirs
        assert len(data) == len(serialize_message(theirs))
        decoded = decode_numbers_message(name, serialize_message(theirs))
        assert decoded.header.stamp.sec * 10**9 + decoded.header.stamp.nanosec == stamp
        assert (decoded.header.frame_id, getattr(decoded, "child_frame_id", child)) == (frame, child)
        assert flat(decoded) == NUMBERS[: len(ours.numbers)].tolist()


def flat(message):
    p, q = message.pose.pose.position, message.pose.pose.orientation
    numbers = [p.x, p.y, p.z, q.x, q.y, q.z, q.w, *message.pose.covariance]
    if hasattr(message, "twist"):
        linear, angular = message.twist.twist.linear, message.twist.twist.angular
        numbers += [linear.x, linear.y, linear.z, angular.x, angular.y, angular.z, *message.twist.covariance]
    return numbers


def test_other_types_byte_orders_and_sizes_are_left_to_the_library():
    data = serialize_message(fill(PoseWithCovarianceStamped, 0, "map"))
    assert decode_numbers_message(POSE, data) is not None
    assert decode_numbers_message("sensor_msgs/msg/Imu", data) is None
    assert decode_numbers_message(POSE, b"\0\0\0\0" + data[4:]) is None
    assert decode_numbers_message(POSE, data + bytes(8)) is None
    assert decode_numbers_message(ODOMETRY, data) is None
    assert decode_numbers_message(POSE, data[:-1]) is None
    assert decode_numbers_message(POSE, data[:12] + b"\xff\xff\xff\xff" + data[16:]) is None
