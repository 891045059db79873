"""The robot's pose from both message types that may hold it: the same values, the same refusals."""

import math

import numpy as np
import pytest
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from scipy.spatial.transform import Rotation

from diffbot_control.ros.messages.fields import pose_from
from diffbot_control.ros.sensors import KnownNoise, stamped_pose
from diffbot_core.errors import BadMessageError

KINDS = pytest.mark.parametrize("kind", [PoseWithCovarianceStamped, Odometry], ids=lambda kind: kind.__name__)
P = np.array([[0.04, 0.03, 0.001], [0.03, 0.09, -0.002], [0.001, -0.002, 0.0025]])


def estimate(kind, covariance=P, roll_pitch_yaw=(0.0, 0.0, -2.5)):
    message = kind()
    message.header.frame_id = "map"
    message.header.stamp.sec, message.header.stamp.nanosec = 12, 345
    if kind is Odometry:
        message.child_frame_id = "base_link"
    message.pose.pose.position.x, message.pose.pose.position.y = 3.0, -4.0
    q = message.pose.pose.orientation
    q.x, q.y, q.z, q.w = Rotation.from_euler("xyz", roll_pitch_yaw).as_quat().tolist()
    full = np.diag([0.0, 0.0, 7.0, 8.0, 9.0, 0.0])
    full[np.ix_([0, 1, 5], [0, 1, 5])] = covariance
    message.pose.covariance = full.reshape(36)
    return message


def read(message):
    return pose_from(message, "map", "base_link")


@KINDS
def test_stamp_pose_and_standard_deviations(kind):
    stamp, pose, uncertainty = read(estimate(kind))
    assert stamp == 12_000_000_345
    assert pose == pytest.approx((3.0, -4.0, -2.5), abs=1e-12)
    assert uncertainty.xy == pytest.approx(math.sqrt(np.linalg.eigvalsh(P[:2, :2])[-1]), rel=1e-12)
    assert uncertainty.theta == pytest.approx(0.05, rel=1e-12)
    # Filters in three dimensions send roll and pitch, too.
    _, pose, _ = read(estimate(kind, roll_pitch_yaw=(0.1, -0.05, 1.2)))
    assert pose.theta == pytest.approx(1.2, abs=1e-12)


@KINDS
def test_an_all_zero_covariance_is_unknown_and_unused_fields_may_hold_anything(kind):
    message = estimate(kind)
    message.pose.covariance = np.diag([0.0, 0.0, math.nan, 7.0, 8.0, 0.0]).reshape(36)
    message.pose.pose.position.z = math.nan
    if kind is Odometry:
        message.twist.twist.linear.x = math.inf
        message.twist.covariance[:] = math.nan
    assert read(message) == (*read(estimate(kind))[:2], None)


WRONG = [np.diag([math.nan, 1.0, 1.0]), np.diag([1.0, -0.1, 1.0]), np.array([[1, 2, 0], [2, 1, 0], [0, 0, 1.0]])]
UNSAID = [np.zeros((3, 3)), np.diag([0.04, 0.04, 0.0]), np.diag([0.04, 0.04, 1e9])]


def test_a_fallback_stands_in_for_an_unknown_covariance_but_not_for_a_wrong_one():
    noise = KnownNoise(np.diag([0.25, 0.25, 0.01]))
    for covariance in UNSAID:
        assert stamped_pose(estimate(PoseWithCovarianceStamped, covariance), "map", noise)[2] is noise.R
    for covariance in WRONG:
        with pytest.raises(BadMessageError, match="covariance not"):
            stamped_pose(estimate(PoseWithCovarianceStamped, covariance), "map", noise)
        # Deviations that replace those of all messages replace wrong ones, too.
        always = noise._replace(always=True)
        assert stamped_pose(estimate(PoseWithCovarianceStamped, covariance), "map", always)[2] is noise.R
