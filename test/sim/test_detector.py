"""Detector of a dock: range, errors and covariance."""

import math

import numpy as np
import pytest

from diffbot_control.filter.dock import DockedPose, robot_at_dock
from diffbot_core.geometry import Pose, into_frame, out_of_frame
from diffbot_sim import sensors
from diffbot_sim.config import DetectorConfig, SensorConfig, dock_pose
from diffbot_sim.noise import DETECTION, DETECTION_FAULT, NoiseSource, quiet_noise
from diffbot_sim.sensors import NO_ERRORS, claimed_noise, detected_dock

CONFIG = DetectorConfig(dock_x=3.0, dock_y=-2.0, dock_yaw=2.5, detection_rate=5.0, detection_dropout=0.0)


def detections(robot, config=CONFIG, count=1500):
    """Return detections of a robot at a pose in the dock's frame."""
    pose = out_of_frame(robot, dock_pose(config))
    noise = NoiseSource().run(5, 1, count, (DETECTION, DETECTION_FAULT))
    return [detected_dock(pose, noise[:, step], config) for step in range(count)]


@pytest.mark.parametrize("robot", [Pose(-0.6, 0.1, 0.1), Pose(-3.0, 1.5, -0.4)])
def test_errors_increase_with_distance_and_have_the_claimed_covariance_in_the_docks_frame(robot):
    found = detections(robot)
    for one in found:
        distance = math.hypot(one.pose.x, one.pose.y)
        assert (one.sigma, one.yaw_sigma) == pytest.approx((0.01 + 0.01 * distance, 0.02 + 0.01 * distance))
    noise = claimed_noise(robot, SensorConfig(detector=CONFIG))
    P = np.array([[noise.xx, noise.xy, noise.xt], [noise.xy, noise.yy, noise.yt], [noise.xt, noise.yt, noise.tt]])
    sigma, yaw_sigma = 0.01 + 0.01 * math.hypot(robot.x, robot.y), 0.02 + 0.01 * math.hypot(robot.x, robot.y)
    R, marker = np.diag((sigma**2, sigma**2, yaw_sigma**2)), into_frame(Pose(0.0, 0.0, 0.0), robot)
    np.testing.assert_allclose(P, DockedPose(0.0, 0.0, 0.0).covariance(marker, R), rtol=1e-9, atol=1e-15)
    scale = np.sqrt(np.outer(P.diagonal(), P.diagonal()))
    errors = np.subtract([robot_at_dock(one.pose) for one in found], robot)
    np.testing.assert_allclose(np.cov(errors.T) / scale, P / scale, atol=0.08)
    np.testing.assert_allclose(errors.mean(axis=0) / np.sqrt(P.diagonal()), 0.0, atol=4.0 / math.sqrt(len(found)))


def test_dropouts_and_outliers_have_their_shares_and_are_independent():
    robot = Pose(-2.0, 0.3, 0.2)
    config = CONFIG._replace(detection_dropout=0.3, detection_outlier=0.2)
    found, plain = detections(robot, config), detections(robot)
    lost = np.array([one.lost for one in found])
    off = np.subtract([one.pose[:2] for one in found], [one.pose[:2] for one in plain])
    outliers = np.hypot(*off.T) > 1e-9
    assert np.hypot(*off[outliers].T) == pytest.approx(0.5)
    assert np.abs(off[outliers].mean(axis=0)).max() < 0.1, "in all directions"
    assert (lost.mean(), outliers.mean()) == pytest.approx((0.3, 0.2), abs=0.04)
    assert (lost & outliers).mean() == pytest.approx(0.06, abs=0.02)
    assert [one.pose.theta for one in found] == [one.pose.theta for one in plain]
    assert not any(one.lost for one in plain)


def test_the_dock_is_detected_within_the_range_of_distances():
    found = [detections(Pose(-x, 0.0, 0.0), CONFIG, 1)[0].lost for x in (0.25, 0.35, 7.95, 8.05)]
    assert found == [True, False, False, True]


def test_with_a_detector_poses_are_measured_at_its_rate_in_the_frame_of_the_dock():
    robot, noise = Pose(-2.0, 0.4, 0.3), quiet_noise(0)[:, 0]
    config = SensorConfig(fix_rate=10.0, detector=CONFIG._replace(detection_rate=2.0, detection_delay=0.3))
    fix = sensors.measured_pose(out_of_frame(robot, dock_pose(config.detector)), NO_ERRORS, noise, config)
    assert fix.pose == pytest.approx(robot, abs=1e-12)
    assert (sensors.pose_delay(config), fix.lost) == (0.3, False)
    assert [step for step in range(21) if sensors.is_pose_due(step, config, 0.1)] == [0, 5, 10, 15, 20]
    without = config._replace(detector=DetectorConfig())
    assert sensors.measured_pose(robot, NO_ERRORS, noise, without).pose == robot
    var_x, var_y, var_theta = sensors.fix_variances(without)
    assert claimed_noise(robot, without) == (var_x, 0.0, var_y, 0.0, 0.0, var_theta)
    assert all(sensors.is_pose_due(step, without, 0.1) for step in range(21))
