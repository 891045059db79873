"""Sensors of the ekf: which covariance is used, and which messages are refused."""

import math

import numpy as np
import pytest
from filter_input import fix, heading, timed
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import Imu

from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_control.ros.sensors import sensors_of
from diffbot_core.errors import BadMessageError, InvalidValueError
from diffbot_core.geometry import Pose
from diffbot_core.schema import build

NOISE = {"global_pose_sigma_xy": 0.3, "global_pose_sigma_yaw": 0.1, "heading_sigma": 0.2}


def sensors(**values):
    return {one.topic: one for one in sensors_of(build(EkfNodeConfig, values))}


@pytest.mark.parametrize("taken", ["heading", "odom", "detected_dock_pose"])
def test_two_inputs_cannot_have_one_topic(taken):
    expected = rf"pose_sources = \['gps', '{taken}'\]: must be topics of no other input, not {taken}"
    with pytest.raises(InvalidValueError, match=expected):
        sensors(pose_sources=["gps", taken])


def test_an_unknown_covariance_is_that_of_the_parameters_and_is_named():
    known, found = sensors(), sensors(**NOISE)
    without_pose, without_heading = fix(), heading()
    without_pose.pose.covariance[:] = 0.0
    without_heading.orientation_covariance[:] = 0.0
    messages = {"global_pose": without_pose, "heading": without_heading}
    expected = {"global_pose": [0.09, 0.09, 0.01], "heading": [0.04]}
    for topic, message in messages.items():
        (measured,), uses_fallback, *_ = found[topic].read(message)
        assert uses_fallback
        np.testing.assert_allclose(measured.R, np.diag(expected[topic]))
        with pytest.raises(BadMessageError, match="covariance is zero"):
            known[topic].read(message)
    for topic, message in {"global_pose": fix(), "heading": heading()}.items():
        assert not found[topic].read(message).uses_fallback


def imu(rate=0.5, variance=4e-4):
    message = timed(Imu(), 5.0)
    message.header.frame_id = "imu_link"
    message.angular_velocity.z = rate
    message.angular_velocity_covariance[8] = variance
    return message


def test_the_turn_rate_of_an_imu_is_read_in_any_frame_with_its_variance_or_that_of_the_parameters():
    gyro = sensors(use_gyro=True, gyro_sigma=0.03)["imu"]
    assert gyro.read(imu()).gyro == (5_000_000_000, 0.5, 4e-4)
    unknown = gyro.read(imu(variance=0.0))
    assert unknown.uses_fallback
    assert unknown.gyro.variance == pytest.approx(9e-4)
    assert sensors(use_gyro=True, gyro_sigma=0.03, override_covariance=True)["imu"].read(imu()).gyro.variance == (
        pytest.approx(9e-4)
    )


def test_an_imu_without_a_usable_turn_rate_is_refused():
    gyro, absent = sensors(use_gyro=True, gyro_sigma=0.0)["imu"], imu()
    absent.angular_velocity_covariance[0] = -1.0
    for message, expected in (
        (absent, "no angular velocity in it"),
        (imu(rate=math.nan), "turn rate"),
        (imu(rate=1e9), "turn rate"),
        (imu(variance=-1.0), "covariance"),
        (imu(variance=0.0), "covariance is zero"),
    ):
        with pytest.raises(BadMessageError, match=expected):
            gyro.read(message)


def detection(covariance=0.0):
    message = fix(5.0, 2.0, 0.0, 0.0)
    message.header.frame_id = "camera"
    message.pose.covariance[:] = 0.0
    message.pose.covariance[[0, 7, 35]] = covariance
    return message


DOCK = {"detector_frame": "camera", "detector_x": 0.5, "dock_sigma_per_metre": 0.02, "dock_yaw_sigma": 0.03}


def test_a_detected_dock_is_a_fix_of_the_robot_before_it():
    found = sensors(dock_detection="pose_with_covariance", **DOCK)["detected_dock_pose"]
    (fixed,), uses_fallback, *_ = found.read(detection(0.01))
    assert not uses_fallback
    assert (fixed.stamp, fixed.pose) == (5 * 10**9, Pose(-2.5, 0.0, 0.0))
    # The heading's error turns the robot about the dock.
    np.testing.assert_allclose(fixed.R, [[0.01, 0.0, 0.0], [0.0, 0.01 + 2.5**2 * 0.01, -0.025], [0.0, -0.025, 0.01]])


def test_a_detection_without_covariance_has_that_of_the_parameters_at_its_distance():
    bare, with_covariance = detection(), detection()
    bare = PoseStamped(header=bare.header, pose=bare.pose.pose)
    for kind, message in (("pose", bare), ("pose_with_covariance", with_covariance)):
        (fixed,), uses_fallback, *_ = sensors(dock_detection=kind, **DOCK)["detected_dock_pose"].read(message)
        assert uses_fallback
        assert fixed.R[0, 0] == pytest.approx(0.05**2)
        assert fixed.R[2, 2] == pytest.approx(0.05**2)
    assert "detected_dock_pose" not in sensors()
    with pytest.raises(BadMessageError, match="frame"):
        sensors(dock_detection="pose")["detected_dock_pose"].read(bare)


def test_a_detector_that_hangs_says_nothing_new():
    found = sensors(dock_detection="pose_with_covariance", **DOCK)["detected_dock_pose"]
    found.read(detection(0.01))
    again = detection(0.01)
    again.header.stamp.sec += 1
    with pytest.raises(BadMessageError, match="the same pose again"):
        found.read(again)
    again.pose.pose.position.x += 1e-9
    assert found.read(again).measurements
