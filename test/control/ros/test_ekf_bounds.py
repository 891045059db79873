"""The ekf publishes only finite numbers for all parameters within their bounds."""

import numpy as np
import pytest
from extremes import assert_finite, extreme_configs, log_between
from filter_input import fix, heading, joint_state, odometry, timed
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import Imu, PointCloud2, PointField

from diffbot_control.filter.covariance import uncertainty_of
from diffbot_control.filter.localization import Localization
from diffbot_control.ros.messages.ekf import EkfInputs, localization_values
from diffbot_control.ros.messages.fields import MAX_SPEED
from diffbot_control.ros.messages.landmark_cloud import LandmarkPoint, fill_landmark_points
from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_control.ros.sensors import fuse
from diffbot_core.errors import BadMessageError
from diffbot_core.geometry import MAX_COORDINATE
from diffbot_core.schema import build

PAIRS = 12
STEPS = 2
"""Number of steps of a drive. The last step has numbers of any size that messages may contain."""
BASE = build(
    EkfNodeConfig,
    {
        "pose_sources": ["gps"],
        **{f"pose_source_{name}": [0.1] for name in ("sigma_xy", "sigma_yaw", "delay")},
        "correlation_times": [0.1] * 4,
        "landmark_ids": [1],
        "landmark_x": [2.0],
        "landmark_y": [1.0],
        "use_gyro": True,
    },
)


def readings(inputs, time, far, variances):
    """Yield a function for each sensor that reads its message."""
    fixes = fix(time, far, 2.0, 0.5), fix(time, 1.0, far, 0.6)
    for one in fixes:
        one.pose.covariance[[0, 7, 35]] = variances
    compass = heading(time, 0.6)
    compass.orientation_covariance[8] = variances[0]
    cloud = timed(PointCloud2(), time)
    cloud.header.frame_id = "base_link"
    fill_landmark_points(cloud, [LandmarkPoint(1, max(abs(far), 1e-3), -2.0, *variances[:2])], PointField)
    gyro = timed(Imu(), time)
    gyro.angular_velocity.z = min(max(far, -MAX_SPEED), MAX_SPEED)
    gyro.angular_velocity_covariance[8] = variances[1]
    by_topic = {"global_pose": fixes[0], "gps": fixes[1], "heading": compass, "landmarks": cloud, "imu": gyro}
    detection = fix(time, far, 1.0, 0.3)
    detection.header.frame_id = "base_link"
    detection.pose.covariance[[0, 7, 35]] = variances
    bare = PoseStamped(header=detection.header, pose=detection.pose.pose)
    for sensor in inputs.sensors.values():
        if sensor.topic == "detected_dock_pose":
            by_topic[sensor.topic] = bare if sensor.message_type.endswith("/PoseStamped") else detection
        yield lambda sensor=sensor: sensor.read(by_topic[sensor.topic])


def drive(config, rng):
    """Yield the numbers and texts that the node publishes after each odometry that is not refused."""
    landmarks, separation = tuple(config.landmarks.points().values()), config.wheels.wheel_separation
    inputs, localization = EkfInputs(config), Localization(config.localization, separation, landmarks=landmarks)
    time = 1000.0
    for step in range(STEPS):
        wild = step == STEPS - 1
        time += float(rng.choice((1e-3, 0.1, 30.0))) if wild else 0.1
        variances = [log_between(1e-13, 1e8, rng) if wild else float(rng.choice((0.0, 0.01))) for _ in range(3)]
        v, omega = [log_between(-MAX_SPEED, MAX_SPEED, rng) if wild else 0.5 for _ in range(2)]
        far = log_between(-MAX_COORDINATE, MAX_COORDINATE, rng) if wild else 1.0
        for read in readings(inputs, time, far, variances):
            try:
                fuse(read(), localization, lambda _: None)
            except BadMessageError:
                continue
        moved = odometry(time, v, omega)
        moved.twist.covariance[[0, 5, 30, 35]] = variances[0], 0.0, 0.0, variances[1]
        by_wheels = config.odometry_source == "joint_states"
        try:
            given = inputs.joint_states(joint_state(time, v, omega)) if by_wheels else inputs.odometry(moved)
            estimate = localization.on_odometry(given)
        except BadMessageError:
            continue
        twist, covariance = localization.twist_of(estimate, given)
        texts = " ".join(localization_values(localization).values())
        yield (estimate.pose, estimate.P, uncertainty_of(estimate.P), twist, covariance), texts


# Extreme covariances are ill-conditioned, but the estimates must be finite.
@pytest.mark.filterwarnings("ignore:An ill-conditioned matrix")
def test_estimates_are_finite_for_all_parameters_and_numbers_of_any_size():
    rng = np.random.default_rng(1)
    answers = 0
    for values, config in extreme_configs(EkfNodeConfig, 2, PAIRS, BASE):
        for numbers, texts in drive(config, rng):
            assert_finite(numbers, values)
            assert not {"nan", "inf"} & set(texts.split()), (texts, values)
            answers += 1
    assert answers > 200
