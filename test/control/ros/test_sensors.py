"""Sensors of the ekf: covariances, mounting of an Imu, detections of a dock, and messages that are refused."""

import math

import numpy as np
import pytest
from filter_input import fix, heading, timed
from geometry_msgs.msg import PoseStamped, Quaternion, Transform, Vector3
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import Imu

from diffbot_control.ros.parameters.dock import DockEkfConfig
from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_control.ros.sensors import sensors_of
from diffbot_control.ros.transforms import NO_TRANSFORMS
from diffbot_core.errors import BadMessageError, InvalidValueError
from diffbot_core.schema import build

UPRIGHT = Rotation.identity()


class FakeTransforms:
    """Finds one transform with this rotation; None: no transform is known yet."""

    available = True

    def __init__(self, rotation=UPRIGHT, x=0.0):
        self.rotation, self.x, self.lookups = rotation, x, []

    def lookup(self, target, source, stamp):
        self.lookups.append((target, source, stamp))
        if self.rotation is None:
            raise BadMessageError("no transform", f"{source} is unknown")
        return Transform(translation=Vector3(x=self.x), rotation=quaternion(self.rotation))


def quaternion(rotation):
    x, y, z, w = rotation.as_quat()
    return Quaternion(x=x, y=y, z=z, w=w)


def sensors(transforms=NO_TRANSFORMS, **values):
    return {sensor.topic: sensor for sensor in sensors_of(build(EkfNodeConfig, values), transforms)}


@pytest.mark.parametrize("topic", ["heading", "odom", "detected_dock_pose", "pose"])
def test_a_source_of_fixes_cannot_have_another_topic_of_the_node(topic):
    expected = rf"pose_sources = \['gps', '{topic}'\]: {topic} is already another topic of the node"
    with pytest.raises(InvalidValueError, match=expected):
        sensors(pose_sources=["gps", topic])


def test_the_parameters_replace_an_unknown_covariance():
    sigmas = {"global_pose_sigma_xy": 0.3, "global_pose_sigma_yaw": 0.1, "heading_sigma": 0.2, "gyro_sigma": 0.03}
    with_sigmas, without = sensors(use_gyro=True, **sigmas), sensors(use_gyro=True, gyro_sigma=0.0)
    without_pose, without_heading = fix(), heading()
    without_pose.pose.covariance[:] = 0.0
    without_heading.orientation_covariance[:] = 0.0
    for topic, bare, known, variances in (
        ("global_pose", without_pose, fix(), [0.09, 0.09, 0.01]),
        ("heading", without_heading, heading(), [0.04]),
        ("imu", imu(variance=0.0), imu(), [9e-4]),
    ):
        found = with_sigmas[topic].read(bare)
        R = np.atleast_2d(found.gyro.variance) if topic == "imu" else found.measurements[0].R
        assert found.uses_fallback
        np.testing.assert_allclose(R, np.diag(variances))
        assert not with_sigmas[topic].read(known).uses_fallback
        with pytest.raises(BadMessageError, match="covariance is zero"):
            without[topic].read(bare)
    assert with_sigmas["imu"].read(imu()).gyro == (5_000_000_000, 0.5, 4e-4)
    overriding = sensors(use_gyro=True, gyro_sigma=0.03, override_covariance=True)["imu"]
    assert overriding.read(imu()).gyro.variance == pytest.approx(9e-4)


@pytest.mark.parametrize(("name", "variances"), [("xy", (0.09, 0.09, None)), ("yaw", (None, None, 0.09))])
def test_a_single_deviation_overrides_its_part_of_a_covariance(name, variances):
    sensor = sensors(override_covariance=True, **{f"global_pose_sigma_{name}": 0.3})["global_pose"]
    before = sensors()["global_pose"].read(fix()).measurements[0].R
    R = sensor.read(fix()).measurements[0].R
    expected = [old if new is None else new for old, new in zip(np.diag(before), variances, strict=True)]
    np.testing.assert_allclose(R, np.diag(expected))


def test_a_message_with_a_zero_stamp_is_refused():
    found = sensors(use_gyro=True)
    for topic, message in {"global_pose": fix(0.0), "heading": heading(0.0), "imu": timed(imu(), 0.0)}.items():
        with pytest.raises(BadMessageError, match="stamp is zero"):
            found[topic].read(message)


def imu(rate=0.5, variance=4e-4, frame="imu_link"):
    message = timed(Imu(), 5.0)
    message.header.frame_id = frame
    message.angular_velocity.z = rate
    message.angular_velocity_covariance[8] = variance
    return message


@pytest.mark.parametrize("angles", [(0.0, 0.0, 0.0), (1.2, 0.0, 0.0), (0.0, 0.0, math.pi), (0.5, -0.3, 1.0)])
def test_turn_rate_and_heading_belong_to_the_robot_for_any_mounting_of_the_imu(angles):
    on_robot = Rotation.from_euler("ZYX", angles)
    transforms = FakeTransforms(on_robot.inv())  # from base_link to imu_link
    found = sensors(transforms, use_gyro=True)
    message = imu()
    rates = on_robot.inv().apply((0.0, 0.0, 0.5))
    message.angular_velocity.x, message.angular_velocity.y, message.angular_velocity.z = rates
    content = found["imu"].read(message)
    assert (content.gyro.rate, content.assumed) == (pytest.approx(0.5), "")
    for yaw in (0.0, 2.5, -1.0):
        message = heading(5.0)
        message.header.frame_id = "imu_link"
        message.orientation = quaternion(Rotation.from_euler("z", yaw) * on_robot)
        content = found["heading"].read(message)
        assert (content.measurements[0].z[0], content.assumed) == (pytest.approx(yaw), "")
    assert {lookup[:2] for lookup in transforms.lookups} == {("imu_link", "base_link")}


def test_an_imu_without_a_transform_is_assumed_to_be_upright_after_two_seconds_until_the_transform_arrives():
    transforms = FakeTransforms(None)
    gyro = sensors(transforms, use_gyro=True)["imu"]
    for seconds in (5.0, 6.9):
        with pytest.raises(BadMessageError, match="no transform"):
            gyro.read(timed(imu(), seconds))
    for seconds in (7.0, 100.0):
        content = gyro.read(timed(imu(), seconds))
        assert content.gyro.rate == 0.5
        assert content.assumed.startswith("no transform between 'imu_link' and 'base_link': the sensor is used as if")
    transforms.rotation = Rotation.from_euler("x", math.pi)
    content = gyro.read(timed(imu(), 101.0))
    assert (content.gyro.rate, content.assumed) == (pytest.approx(-0.5), "")


@pytest.mark.parametrize("frame", ["base_link", ""])
def test_an_imu_in_the_frame_of_the_robot_or_without_a_frame_needs_no_transform(frame):
    content = sensors(FakeTransforms(None), use_gyro=True)["imu"].read(imu(frame=frame))
    assert (content.gyro.rate, content.assumed) == (0.5, "")


def test_an_imu_without_a_usable_turn_rate_is_refused():
    gyro, absent = sensors(use_gyro=True)["imu"], imu()
    absent.angular_velocity_covariance[0] = -1.0
    for message, expected in (
        (absent, "no angular velocity"),
        (imu(rate=math.nan), "turn rate"),
        (imu(rate=1e9), "turn rate"),
        (imu(variance=-1.0), "covariance"),
    ):
        with pytest.raises(BadMessageError, match=expected):
            gyro.read(message)


def detection(frame="camera"):
    """Return a detection 2 m before the camera, without a covariance."""
    message = fix(5.0, 2.0, 0.0, 0.0)
    message.header.frame_id = frame
    message.pose.covariance[:] = 0.0
    return message


def dock_sensor(kind="pose_with_covariance", transforms=NO_TRANSFORMS):
    config = build(DockEkfConfig, {"dock_sigma": 0.03, "dock_yaw_sigma": 0.03, "dock_detection": kind})
    return {sensor.topic: sensor for sensor in sensors_of(config, transforms)}["detected_dock_pose"]


def test_a_detection_is_a_fix_of_the_robot_in_the_frame_of_the_dock():
    message, rotation = detection(), Rotation.from_euler("ZY", (0.7, 0.4))
    block = np.diag((0.04, 0.01, 0.09))
    whole = np.zeros((6, 6))
    whole[:3, :3], whole[3:, 3:] = block, 0.1 * block
    message.pose.covariance[:] = whole.ravel()
    # The axes of the marker are parallel to the axes of the robot.
    message.pose.pose.orientation = quaternion(rotation.inv())
    camera = FakeTransforms(rotation, 0.5)
    (fixed,), uses_fallback, *_ = dock_sensor(transforms=camera).read(message)
    assert (fixed.stamp, uses_fallback) == (5 * 10**9, False)
    assert set(camera.lookups) == {("base_link", "camera", 5 * 10**9)}
    spatial = rotation.as_matrix() @ block @ rotation.as_matrix().T
    marker = np.array((0.5, 0.0)) + (rotation.as_matrix() @ (2.0, 0.0, 0.0))[:2]
    np.testing.assert_allclose(fixed.z, (*-marker, 0.0), atol=1e-12)
    # The heading error rotates the robot about the dock.
    across, R = np.array((marker[1], -marker[0], 1.0)), np.zeros((3, 3))
    R[:2, :2] = spatial[:2, :2]
    np.testing.assert_allclose(fixed.R, R + 0.1 * spatial[2, 2] * np.outer(across, across), atol=1e-12)


def test_the_deviations_of_a_detection_without_covariance_grow_with_the_distance():
    with_covariance = detection()
    bare = PoseStamped(header=with_covariance.header, pose=with_covariance.pose.pose)
    for kind, message in (("pose", bare), ("pose_with_covariance", with_covariance)):
        (fixed,), uses_fallback, *_ = dock_sensor(kind, FakeTransforms(x=0.5)).read(message)
        assert uses_fallback
        assert fixed.R[0, 0] == fixed.R[2, 2] == pytest.approx(0.05**2)
    assert "detected_dock_pose" not in sensors()
    with pytest.raises(BadMessageError, match="frame"):
        dock_sensor("pose").read(bare)


def test_a_repeated_detection_is_refused():
    sensor, message = dock_sensor(), detection("base_link")
    sensor.read(message)
    message.header.stamp.sec += 1
    with pytest.raises(BadMessageError, match="same pose as before"):
        sensor.read(message)
    message.pose.pose.position.x += 1e-9
    assert sensor.read(message).measurements
