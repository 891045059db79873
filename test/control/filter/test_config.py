"""Checks of parameters, map and covariances; options and measurements; pose of the robot at a dock."""

import math

import numpy as np
import pytest
from filter_runs import covariance, jacobian, options

from diffbot_control.filter import models
from diffbot_control.filter.config import LandmarkMap, LocalizationConfig, options_of, sources_of
from diffbot_control.filter.covariance import UnknownCovarianceError, check_covariance
from diffbot_control.filter.dock import DockedPose, robot_at_dock
from diffbot_control.filter.measurement import pose_fix
from diffbot_core.errors import BadMessageError, InvalidValueError
from diffbot_core.geometry import Point, Pose
from diffbot_core.schema import build


@pytest.mark.parametrize(
    ("values", "name"),
    [
        ({"pose_sources": ["global_pose"]}, "pose_sources"),
        ({"pose_sources": ["gps", "gps"]}, "pose_sources"),
        ({"pose_sources": [f"gps{i}" for i in range(9)]}, "pose_sources"),
        ({"pose_sources": ["a topic"]}, "pose_sources"),
        ({"pose_sources": ["~gps"]}, "pose_sources"),
        ({"pose_sources": ["gps"], "pose_source_delay": [0.1, 0.2]}, "pose_source_delay"),
        ({"pose_sources": ["gps"], "pose_source_delay": [1.5]}, "pose_source_delay"),
        ({"pose_sources": ["gps"], "pose_source_sigma_xy": [1e-5]}, "pose_source_sigma_xy"),
    ],
)
def test_invalid_parameters_are_refused_with_their_name(values, name):
    with pytest.raises(InvalidValueError) as caught:
        build(LocalizationConfig, values)
    assert str(caught.value).startswith(name)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("found", "name"),
    [
        (LandmarkMap((1, 2, 1), (1.0, 2.0, 3.0), (1.0, 2.0, 3.0)), "landmark_ids"),
        (LandmarkMap((1, 2), (1.0,), (1.0, 2.0)), "landmark_x"),
        (LandmarkMap((1, 2), (1.0, 2.0), (1.0, 2.0, 3.0)), "landmark_y"),
    ],
)
def test_an_inconsistent_map_is_refused(found, name):
    with pytest.raises(InvalidValueError, match=name):
        found.check()


def test_landmarks_are_sorted_by_position():
    found = LandmarkMap((7, -2, 0), (3.0, 2.0, 2.0), (4.0, 6.0, 5.0)).points()
    assert list(found.items()) == [(0, (2.0, 5.0)), (-2, (2.0, 6.0)), (7, (3.0, 4.0))]


def test_sources_and_correlation_times_have_the_order_of_the_rows():
    sources = {"pose_sources": ["gps", "uwb"], "pose_source_delay": [0.5, 0.0]}
    for times in ([], [1.0, 2.0, 3.0, 4.0, 5.0]):
        config = build(LocalizationConfig, {**sources, "correlation_times": times})
        assert options_of(config).times == (*times, *[0.0] * (5 - len(times)))
    with pytest.raises(InvalidValueError, match=r"correlation_times = .* at most 5 values"):
        build(LocalizationConfig, {**sources, "correlation_times": [0.0] * 6})
    assert sources_of(config) == ["fixes", "headings", "landmarks", "fixes of gps", "fixes of uwb"]
    assert [one.delay for one in config.sources.settings()] == [0.5, 0.0]


def test_options_contain_the_parameters_that_the_variant_needs():
    values = {"left_radius_error": 0.01, "right_radius_error": 0.02, "wheel_separation_error": 0.03}
    values |= {"wheel_radius_sigma": 0.04, "wheel_separation_sigma": 0.05, "gyro_bias_sigma": 0.06}
    values |= {"landmark_range_offset": 0.07, "landmark_range_scale": 0.08, "landmark_bearing_offset": 0.09}
    whole = options((Point(0.0, 0.0),), filter="ekf_fnn_calibrating", use_gyro=True, **values)
    assert whole.errors == (0.01, 0.02, 0.03, 0.0, 0.07, 0.08, 0.09)
    assert whole.variances[:4] == pytest.approx(np.square((0.04, 0.04, 0.05, 0.06)))
    assert (whole.size, whole.fuzzy, whole.finds_noise) == (10, True, False)
    plain = options(filter="ekf", **values)
    assert (plain.size, plain.fuzzy, plain.finds_noise) == (3, False, True)
    assert plain.errors[:4] == plain.variances[:4] == (0.0, 0.0, 0.0, 0.0)
    assert not options(detect_correlation=False).finds_noise
    assert options(use_gyro=True, wheel_radius_sigma=0.01).max_radius_error == pytest.approx(0.2)


def test_a_fix_with_an_unknown_heading_is_a_position():
    for var_theta, kind, m in ((9.8, models.POSE_FIX, 3), (math.pi**2, models.POSITION_FIX, 2)):
        R = np.diag([0.1, 0.2, var_theta])
        made = pose_fix(5, Pose(1.0, 2.0, 3.0), R)
        assert (made.kind, made.z.tolist(), made.R.tolist()) == (kind, [1.0, 2.0, 3.0][:m], R[:m, :m].tolist())


@pytest.mark.parametrize(
    ("matrix", "kind", "unknown"),
    [
        (np.diag([1e8, 1.0, 1e-12]), "", False),
        # Rounded to float32.
        (np.array([[1.0, 0.5], [0.5 + 5e-7, 1.0]]), "", False),
        (np.array([[1.0, math.inf], [-math.inf, 1.0]]), "covariance not finite", False),
        (np.full((3, 3), 1e308), "covariance not finite", False),
        (np.zeros((3, 3)), "covariance is zero", True),
        (np.diag([1e9, 1.0, 1.0]), "covariance too large", True),
        (np.array([[1.0, 0.5], [0.5 + 2e-6, 1.0]]), "covariance not symmetric", False),
        (np.array([[1.0, 1.1], [1.1, 1.0]]), "covariance not positive definite", False),
        # The inverse overflows.
        (np.diag([1.0, 1.0, 1e-310]), "covariance not positive definite", True),
        # -1 means unknown in some ROS messages.
        (np.array([[-1.0]]), "covariance not positive definite", False),
    ],
)
def test_invalid_covariances_are_refused_with_the_reason(matrix, kind, unknown):
    if not kind:
        np.testing.assert_array_equal(check_covariance(matrix.copy()), matrix)
        return
    with pytest.raises(BadMessageError) as caught:
        check_covariance(matrix)
    assert caught.value.kind == kind
    assert isinstance(caught.value, UnknownCovarianceError) == unknown


POSES = [Pose(1.5, 0.4, 0.7), Pose(-0.3, 0.9, -2.6), Pose(0.6, -0.2, 3.1)]


def matrix(pose):
    c, s = math.cos(pose.theta), math.sin(pose.theta)
    return np.array([[c, -s, pose.x], [s, c, pose.y], [0.0, 0.0, 1.0]])


@pytest.mark.parametrize("detected", POSES)
def test_the_pose_at_the_dock_is_the_inverse_of_the_detection_with_its_covariance(detected):
    np.testing.assert_allclose(matrix(robot_at_dock(detected)), np.linalg.inv(matrix(detected)), atol=1e-12)
    docked, R = DockedPose(-0.35, 0.05, -1.2), covariance(np.random.default_rng(2), 3)
    expected = np.linalg.inv(matrix(detected) @ matrix(Pose(*docked)))
    np.testing.assert_allclose(matrix(docked.robot(detected)), expected, atol=1e-12)
    J = jacobian(lambda at: np.array(docked.robot(Pose(*at))), detected)
    np.testing.assert_allclose(docked.covariance(detected, R), J @ R @ J.T, rtol=1e-6, atol=1e-8)
