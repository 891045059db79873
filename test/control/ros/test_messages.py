"""Pose and covariance of the messages that may contain an estimate."""

import math

import numpy as np
import pytest
from filter_input import START, odometry
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from scipy.spatial.transform import Rotation

from diffbot_control.ros.messages.ekf import EkfInputs
from diffbot_control.ros.messages.fields import pose_from
from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_control.ros.sensors import KnownNoise, stamped_pose
from diffbot_core.errors import BadMessageError

P = np.array([[0.04, 0.03, 0.001], [0.03, 0.09, -0.002], [0.001, -0.002, 0.0025]])


def estimate(kind=PoseWithCovarianceStamped, covariance=P, roll_pitch_yaw=(0.0, 0.0, -2.5)):
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


@pytest.mark.parametrize("kind", [PoseWithCovarianceStamped, Odometry], ids=lambda kind: kind.__name__)
def test_an_estimate_has_a_stamp_a_planar_pose_and_an_uncertainty_unless_its_covariance_is_zero(kind):
    stamp, pose, uncertainty = pose_from(estimate(kind), "map", "base_link")
    assert stamp == 12_000_000_345
    assert pose == pytest.approx((3.0, -4.0, -2.5), abs=1e-12)
    assert uncertainty.xy == pytest.approx(math.sqrt(np.linalg.eigvalsh(P[:2, :2])[-1]), rel=1e-12)
    assert uncertainty.theta == pytest.approx(0.05, rel=1e-12)
    # Filters in three dimensions also estimate roll and pitch.
    _, tilted, _ = pose_from(estimate(kind, roll_pitch_yaw=(0.1, -0.05, 1.2)), "map", "base_link")
    assert tilted.theta == pytest.approx(1.2, abs=1e-12)
    # Fields that are not used may contain anything.
    message = estimate(kind)
    message.pose.covariance = np.diag([0.0, 0.0, math.nan, 7.0, 8.0, 0.0]).reshape(36)
    message.pose.pose.position.z = math.nan
    if kind is Odometry:
        message.twist.twist.linear.x = math.inf
        message.twist.covariance[:] = math.nan
    assert pose_from(message, "map", "base_link") == (stamp, pose, None)


@pytest.mark.parametrize("variances", [(0.0, 0.0), (1e-3, 0.0), (0.0, 1e-3), (1e9, 1e9)])
def test_an_unknown_covariance_of_the_odometry_is_set_to_zero(variances):
    message = odometry(START)
    message.twist.covariance[:] = 0.0
    message.twist.covariance[[0, 35]] = variances
    assert EkfInputs(EkfNodeConfig()).odometry(message).covariance == (0.0, 0.0, 0.0)


INVALID = [np.diag([math.nan, 1.0, 1.0]), np.diag([1.0, -0.1, 1.0]), np.array([[1, 2, 0], [2, 1, 0], [0, 0, 1.0]])]
UNKNOWN = [np.zeros((3, 3)), np.diag([0.04, 0.04, 0.0]), np.diag([0.04, 0.04, 1e9])]


def test_a_fallback_replaces_an_unknown_covariance_but_an_invalid_one_only_if_it_replaces_all():
    noise = KnownNoise(np.diag([0.25, 0.25, 0.01]))
    for covariance in UNKNOWN:
        assert stamped_pose(estimate(covariance=covariance), "map", noise)[2] is noise.R
    for covariance in INVALID:
        with pytest.raises(BadMessageError, match="covariance not"):
            stamped_pose(estimate(covariance=covariance), "map", noise)
        assert stamped_pose(estimate(covariance=covariance), "map", noise._replace(always=True))[2] is noise.R
