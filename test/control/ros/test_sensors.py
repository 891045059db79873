"""Sensors of the ekf: which covariance is used, and which messages are refused."""

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

NOISE = {"global_pose_sigma_xy": 0.3, "global_pose_sigma_yaw": 0.1, "heading_sigma": 0.2}


def sensors(transforms=NO_TRANSFORMS, **values):
    return {one.topic: one for one in sensors_of(build(EkfNodeConfig, values), transforms)}


@pytest.mark.parametrize("taken", ["heading", "odom", "detected_dock_pose"])
def test_two_inputs_cannot_have_one_topic(taken):
    expected = rf"pose_sources = \['gps', '{taken}'\]: {taken} is also the topic of another input"
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


class Mounted:
    """A transform from the robot's frame to that of an Imu, turned about the robot's x axis."""

    available = True

    def __init__(self, angle):
        self.rotation = Quaternion(x=math.sin(angle / 2.0), w=math.cos(angle / 2.0))
        self.asked = []

    def lookup(self, target, source, stamp):
        self.asked.append((target, source))
        return Transform(rotation=self.rotation)


@pytest.mark.parametrize("angle", [0.0, 0.3, math.pi / 2.0, math.pi])
def test_the_turn_rate_of_an_imu_is_that_about_the_vertical_axis_of_the_robot(angle):
    mounted = Mounted(angle)
    gyro = sensors(mounted, use_gyro=True)["imu"]
    message = imu()
    # The robot turns by 0.5 rad/s about its z axis, which the Imu sees in its own y and z.
    message.angular_velocity.y, message.angular_velocity.z = -0.5 * math.sin(angle), 0.5 * math.cos(angle)
    found = gyro.read(message)
    assert mounted.asked == [("imu_link", "base_link")]
    assert found.gyro.rate == pytest.approx(0.5)
    assert not found.assumed


@pytest.mark.parametrize("mounting", [(0.0, 0.0, 0.0), (1.2, 0.0, 0.0), (0.0, 0.0, math.pi), (0.5, -0.3, 1.0)])
@pytest.mark.parametrize("yaw", [0.0, 2.5, -1.0])
def test_the_heading_of_an_imu_is_that_of_the_robot_for_any_mounting(mounting, yaw):
    on_robot = Rotation.from_euler("ZYX", mounting)
    mounted = Mounted(0.0)
    mounted.rotation = quaternion(on_robot.inv())  # takes vectors of base_link to imu_link
    message = heading(5.0)
    message.header.frame_id = "imu_link"
    message.orientation = quaternion(Rotation.from_euler("z", yaw) * on_robot)
    content = sensors(mounted)["heading"].read(message)
    assert content.measurements[0].z[0] == pytest.approx(yaw)
    assert (mounted.asked, content.assumed) == ([("imu_link", "base_link")], "")


class Late:
    """Transforms of which none is known at first."""

    available = True

    def __init__(self):
        self.rotation = None

    def lookup(self, target, source, stamp):
        if self.rotation is None:
            raise BadMessageError("no transform", "imu_link is unknown")
        return Transform(rotation=self.rotation)


def test_an_imu_without_a_transform_is_used_as_it_is_after_two_seconds_and_with_it_later():
    late = Late()
    gyro = sensors(late, use_gyro=True)["imu"]
    for seconds, usable in ((5.0, False), (6.9, False), (7.0, True), (100.0, True)):
        message = timed(imu(), seconds)
        if not usable:
            with pytest.raises(BadMessageError, match="no transform"):
                gyro.read(message)
            continue
        found = gyro.read(message)
        assert found.gyro.rate == 0.5
        assert "'imu_link'" in found.assumed
        assert "'base_link'" in found.assumed
    late.rotation = Quaternion(x=1.0, w=0.0)  # upside down
    found = gyro.read(timed(imu(), 101.0))
    assert (found.gyro.rate, found.assumed) == (pytest.approx(-0.5), "")


def test_a_message_without_a_time_is_refused():
    messages = {"global_pose": fix(0.0), "heading": heading(0.0), "imu": timed(imu(), 0.0)}
    found = sensors(use_gyro=True)
    for topic, message in messages.items():
        with pytest.raises(BadMessageError, match="stamp is zero"):
            found[topic].read(message)


def test_an_imu_in_the_frame_of_the_robot_or_without_a_frame_needs_no_transform():
    mounted = Mounted(math.pi)
    for frame in ("base_link", ""):
        message = imu()
        message.header.frame_id = frame
        found = sensors(mounted, use_gyro=True)["imu"].read(message)
        assert (found.gyro.rate, found.assumed) == (0.5, "")
    assert not mounted.asked


def test_without_tf_an_imu_in_another_frame_is_taken_as_upright_and_that_is_said():
    gyro = sensors(use_gyro=True, gyro_sigma=0.03)["imu"]
    assert gyro.read(imu()).gyro == (5_000_000_000, 0.5, 4e-4)
    assert gyro.read(imu()).assumed.startswith("no transform between 'imu_link' and 'base_link': used as if")
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
        (absent, "no angular velocity"),
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


DOCK = {"dock_sigma": 0.03, "dock_yaw_sigma": 0.03}


def quaternion(turn):
    x, y, z, w = turn.as_quat()
    return Quaternion(x=x, y=y, z=z, w=w)


UPRIGHT = Rotation.identity()


class Camera:
    """A transform to the robot's frame from that of a camera 0.5 m before it."""

    available = True

    def __init__(self, turn=UPRIGHT):
        self.rotation = quaternion(turn)

    def lookup(self, target, source, stamp):
        assert (target, source, stamp) == ("base_link", "camera", 5 * 10**9)
        return Transform(translation=Vector3(x=0.5), rotation=self.rotation)


def dock_sensor(kind="pose_with_covariance", transforms=NO_TRANSFORMS):
    config = build(DockEkfConfig, {**DOCK, "dock_detection": kind})
    return {one.topic: one for one in sensors_of(config, transforms)}["detected_dock_pose"]


def test_a_detected_dock_is_a_fix_of_the_robot_before_it():
    (fixed,), uses_fallback, *_ = dock_sensor(transforms=Camera()).read(detection(0.01))
    assert not uses_fallback
    assert (fixed.stamp, *fixed.z) == (5 * 10**9, -2.5, 0.0, 0.0)
    # The heading's error turns the robot about the dock.
    np.testing.assert_allclose(fixed.R, [[0.01, 0.0, 0.0], [0.0, 0.01 + 2.5**2 * 0.01, -0.025], [0.0, -0.025, 0.01]])


def test_the_covariance_of_a_detection_turns_with_the_detector():
    message, turn = detection(), Rotation.from_euler("ZY", (0.7, 0.4))
    block = np.diag((0.04, 0.01, 0.09))
    whole = np.zeros((6, 6))
    whole[:3, :3], whole[3:, 3:] = block, 0.1 * block
    message.pose.covariance[:] = whole.ravel()
    # The marker's own axes are those of the robot.
    message.pose.pose.orientation = quaternion(turn.inv())
    (fixed,), *_ = dock_sensor(transforms=Camera(turn)).read(message)
    spatial = turn.as_matrix() @ block @ turn.as_matrix().T
    marker = np.array((0.5, 0.0)) + (turn.as_matrix() @ (2.0, 0.0, 0.0))[:2]
    np.testing.assert_allclose(fixed.z, (*-marker, 0.0), atol=1e-12)
    var_yaw, across = 0.1 * spatial[2, 2], np.array((marker[1], -marker[0]))
    np.testing.assert_allclose(fixed.R[:2, :2], spatial[:2, :2] + var_yaw * np.outer(across, across), atol=1e-12)
    assert fixed.R[2, 2] == pytest.approx(var_yaw)


def test_a_detection_without_covariance_has_that_of_the_parameters_at_its_distance():
    with_covariance = detection()
    bare = PoseStamped(header=with_covariance.header, pose=with_covariance.pose.pose)
    for kind, message in (("pose", bare), ("pose_with_covariance", with_covariance)):
        (fixed,), uses_fallback, *_ = dock_sensor(kind, Camera()).read(message)
        assert uses_fallback
        assert fixed.R[0, 0] == pytest.approx(0.05**2)
        assert fixed.R[2, 2] == pytest.approx(0.05**2)
    assert "detected_dock_pose" not in sensors()
    with pytest.raises(BadMessageError, match="frame"):
        dock_sensor("pose").read(bare)


def test_a_detector_that_hangs_says_nothing_new():
    found, again = dock_sensor(), detection(0.01)
    again.header.frame_id = "base_link"
    found.read(again)
    again.header.stamp.sec += 1
    with pytest.raises(BadMessageError, match="same pose as before"):
        found.read(again)
    again.pose.pose.position.x += 1e-9
    assert found.read(again).measurements
