"""At the bounds of its parameters and between them, the ekf publishes finite numbers only."""

from types import SimpleNamespace

import numpy as np
from extremes import assert_finite, extreme_configs, log_between
from filter_input import fix, heading, joint_state, odometry
from sensor_msgs.msg import PointCloud2, PointField

from diffbot_control.filter.covariance import uncertainty_of
from diffbot_control.filter.localization import Localization
from diffbot_control.ros.ekf_messages import EkfInputs, corrected_twist, error_values
from diffbot_control.ros.ekf_parameters import EkfNodeConfig
from diffbot_control.ros.landmark_cloud import LandmarkPoint, fill_landmark_points
from diffbot_control.ros.message_fields import MAX_SPEED
from diffbot_core.errors import BadMessageError
from diffbot_core.geometry import MAX_COORDINATE
from diffbot_core.schema import build

PAIRS = 12
STEPS = 3
BASE = build(
    EkfNodeConfig,
    {
        "pose_sources": ["gps"],
        "pose_source_sigma_xy": [0.1],
        "pose_source_sigma_yaw": [0.1],
        "pose_source_correlation_time": [1.0],
        "pose_source_delay": [0.1],
        "landmark_ids": [1, 2],
        "landmark_x": [2.0, -3.0],
        "landmark_y": [1.0, 4.0],
    },
)


def cloud(rng, variances):
    message = PointCloud2()
    message.header.frame_id = "base_link"
    ranges = [log_between(1e-3, MAX_COORDINATE, rng) if rng.random() < 0.3 else 3.0 for _ in range(2)]
    points = [LandmarkPoint(n + 1, ranges[n], float(rng.uniform(-3.0, 3.0)), *variances[:2]) for n in range(2)]
    fill_landmark_points(message, points, PointField)
    return message


def drive(config, rng):
    """Yield what the node publishes and reports after each message of the odometry; most of the drive is a usual one.

    The rest are the largest and smallest numbers that a message may hold. Refused messages are left out.
    """
    inputs, localization = EkfInputs(config), Localization(config.localization, config.wheels.wheel_separation)
    time = 1000.0
    for step in range(STEPS):
        wild = step % 3 == 2
        time += float(rng.choice((1e-3, 0.1, 30.0))) if wild else 0.1
        variances = [log_between(1e-13, 1e8, rng) if wild else float(rng.choice((0.0, 0.01))) for _ in range(3)]
        v, omega = [log_between(-MAX_SPEED, MAX_SPEED, rng) if wild else 0.5 for _ in range(2)]
        far = log_between(-MAX_COORDINATE, MAX_COORDINATE, rng) if wild else 1.0
        for read, message in (
            (inputs.fix, fix(time, far, 2.0, 0.5)),
            (lambda one: inputs.source_fix(0, one), fix(time, 1.0, far, 0.6)),
            (inputs.heading, heading(time, 0.6)),
            (inputs.landmarks, cloud(rng, variances)),
        ):
            if isinstance(message, PointCloud2):
                message.header.stamp = fix(time).header.stamp
            elif hasattr(message, "pose"):
                message.pose.covariance[[0, 7, 35]] = variances
            else:
                message.orientation_covariance[8] = variances[0]
            take(localization, read, message)
        moved = odometry(time, v, omega)
        moved.twist.covariance[[0, 5, 30, 35]] = variances[0], 0.0, 0.0, variances[1]
        try:
            if config.odometry_source == "odom":
                given = inputs.odometry(moved)
            else:
                given = inputs.joint_states(joint_state(time, v, omega))
            estimate = localization.on_odometry(given)
        except BadMessageError:
            continue
        twist = corrected_twist(given.twist, localization.filter, config.wheels.wheel_separation)
        texts = " ".join((localization.monitor.values() | error_values(localization.filter)).values())
        yield SimpleNamespace(
            numbers=(estimate.pose, estimate.P, uncertainty_of(estimate.P), twist, given.covariance), texts=texts
        )


def take(localization, read, message):
    try:
        found = read(message)
        for one in found[0] if isinstance(found, tuple) and isinstance(found[0], list) else [found]:
            localization.on_measurement(one)
    except BadMessageError:
        pass


def test_estimates_are_finite():
    rng = np.random.default_rng(1)
    answers = 0
    for values, config in extreme_configs(EkfNodeConfig, 2, PAIRS, BASE):
        for published in drive(config, rng):
            assert_finite(published.numbers, values)
            assert "nan" not in published.texts, (published.texts, values)
            assert "inf" not in published.texts, (published.texts, values)
            answers += 1
    assert answers > 300
