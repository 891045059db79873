"""A detection turned round: the robot's pose at the dock and its covariance."""

import math

import numpy as np
import pytest
from filter_runs import covariance, jacobian

from diffbot_control.filter.dock import FixNoise, Mounting, noise_at_dock, robot_at_dock, scaled_noise
from diffbot_core.geometry import Pose

POSES = [Pose(1.5, 0.4, 0.7), Pose(-0.3, 0.9, -2.6), Pose(0.6, -0.2, 3.1)]


def matrix(pose):
    c, s = math.cos(pose.theta), math.sin(pose.theta)
    return np.array([[c, -s, pose.x], [s, c, pose.y], [0.0, 0.0, 1.0]])


def full(noise):
    return np.array([[noise.xx, noise.xy, noise.xt], [noise.xy, noise.yy, noise.yt], [noise.xt, noise.yt, noise.tt]])


@pytest.mark.parametrize("detected", POSES)
def test_a_detection_turned_round_is_the_inverse_with_the_covariance_through_the_jacobian(detected):
    np.testing.assert_allclose(matrix(robot_at_dock(detected)), np.linalg.inv(matrix(detected)), atol=1e-12)
    J = jacobian(lambda at: np.array(robot_at_dock(Pose(*at))), detected)
    expected = J @ np.diag((4e-4, 4e-4, 2.5e-3)) @ J.T
    found = full(noise_at_dock(robot_at_dock(detected), 4e-4, 2.5e-3))
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_scaled_variances_keep_the_correlations():
    P = covariance(np.random.default_rng(1), 3)
    factors = np.sqrt((2.0, 2.0, 5.0))
    found = full(scaled_noise(FixNoise(P[0, 0], P[0, 1], P[1, 1], P[0, 2], P[1, 2], P[2, 2]), 2.0, 5.0))
    np.testing.assert_allclose(found, P * np.outer(factors, factors), rtol=1e-12)


@pytest.mark.parametrize("detected", POSES)
def test_a_detector_and_a_marker_anywhere_give_the_robot_and_its_covariance(detected):
    mounting = Mounting(Pose(0.25, -0.1, 2.8), Pose(-0.35, 0.05, -1.2))
    expected = np.linalg.inv(matrix(mounting.detector) @ matrix(detected) @ matrix(mounting.docked))
    np.testing.assert_allclose(matrix(mounting.robot(detected)), expected, atol=1e-12)
    R = covariance(np.random.default_rng(2), 3)
    J = jacobian(lambda at: np.array(mounting.robot(Pose(*at))), detected)
    np.testing.assert_allclose(mounting.covariance(detected, R), J @ R @ J.T, rtol=1e-6, atol=1e-8)
