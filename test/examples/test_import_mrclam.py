"""The bag of an MR.CLAM data set, read by rosbags, against the circle from which the files were made."""

import math

import numpy as np
import pytest
from bag_makers import read
from dataset_files import LANDMARKS, OMEGA, RADIUS, T0, import_mrclam, measured, truth_at, write_mrclam
from robot import planar, stamp, turned

from diffbot_control.ros.messages.landmark_cloud import landmark_points

START = 1_248_446_190_000_000_000


def assert_pose(message, expected, tolerance=1e-7):
    pose = planar(message.pose.pose)
    assert pose[:2] == pytest.approx(expected[:2], abs=tolerance)
    assert turned(pose, expected) < 1e-7


@pytest.fixture(scope="module")
def topics(tmp_path_factory):
    folder = tmp_path_factory.mktemp("data")
    return read(import_mrclam(write_mrclam(folder / "set", robot=3), 3, folder / "bag"))


def test_true_poses_and_start_are_on_the_circle_at_the_time_of_the_row(topics):
    assert set(topics) == {"/odom", "/landmarks", "/ground_truth", "/initialpose"}
    assert all(time == stamp(message) for messages in topics.values() for time, message in messages)
    assert [len(topics[name]) for name in ("/ground_truth", "/initialpose")] == [1100, 1]
    for time, message in topics["/ground_truth"]:
        assert message.header.frame_id == "map"
        assert_pose(message, truth_at((time - START) * 1e-9))
    time, message = topics["/initialpose"][0]
    assert time == topics["/odom"][0][0]
    assert_pose(message, truth_at(0.0))
    covariance = message.pose.covariance.reshape(6, 6)
    assert np.sqrt(covariance[[0, 1, 5], [0, 1, 5]]) == pytest.approx([0.01, 0.01, 0.01])


def test_odometry_has_the_commanded_twist_its_integral_and_unknown_covariances(topics):
    assert len(topics["/odom"]) == 400
    for index, (time, message) in enumerate(topics["/odom"]):
        assert time == START + 50_000_000 * index
        assert (message.header.frame_id, message.child_frame_id) == ("odom", "base_link")
        assert message.twist.twist.linear.x == pytest.approx(RADIUS * OMEGA)
        assert message.twist.twist.angular.z == pytest.approx(OMEGA)
        assert not message.twist.covariance.any()
        angle = OMEGA * 0.05 * index
        assert_pose(message, (RADIUS * math.sin(angle), RADIUS * (1.0 - math.cos(angle)), angle), 1e-4)


def test_landmarks_have_ranges_from_the_depths_and_numbers_from_the_barcodes(topics):
    numbers, bearings = set(), []
    for time, message in topics["/landmarks"]:
        assert message.header.frame_id == "base_link"
        for point in landmark_points(message):
            expected = measured((time - START) * 1e-9, point.number)
            assert (point.range, point.bearing) == pytest.approx(expected, abs=1e-6)
            sigma = 0.03 + 0.025 * point.range
            assert (point.var_range, point.var_bearing) == pytest.approx((sigma**2, 0.02**2), rel=1e-6)
            numbers.add(point.number)
            bearings.append(abs(point.bearing))
    assert numbers == set(LANDMARKS)
    assert max(bearings) > 1.0


def test_repeated_lines_are_dropped_and_a_second_measurement_of_a_landmark_starts_a_new_cloud(tmp_path):
    folder = write_mrclam(tmp_path / "set")
    path = folder / "Robot1_Measurement.dat"
    path.write_text("".join(f"{T0 + 1:.3f} 63 {depth} 0.0\n" for depth in (2.0, 2.0, 2.5)))
    rows = [(0.0, 0.1), (0.0, 9.0), (1.0, 0.2), (3.0, 0.3)]
    (folder / "Robot1_Odometry.dat").write_text("".join(f"{T0 + time:.3f} {v} 0.0\n" for time, v in rows))
    topics = read(import_mrclam(folder, 1, tmp_path / "bag"))
    assert [[p.range for p in landmark_points(m)] for _, m in topics["/landmarks"]] == [[2.0], [2.5]]
    odometry = [(message.twist.twist.linear.x, message.pose.pose.position.x) for _, message in topics["/odom"]]
    assert np.array(odometry) == pytest.approx(np.array([(0.1, 0.0), (0.1, 0.1), (0.2, 0.5)]))


@pytest.mark.parametrize(
    ("name", "line"),
    [
        ("Odometry", "1248446191 0.1"),
        ("Odometry", "1248446191 nan 0.1"),
        ("Measurement", "1248446191 6.3 1 0.1"),
        ("Measurement", "1248446191 63 1 1.6"),
        ("Groundtruth", "1248446191 1e9 1 0" + " " * 5000),
    ],
)
def test_a_line_with_an_error_is_named_and_no_bag_is_written(tmp_path, name, line):
    folder = write_mrclam(tmp_path / "set", duration=2.0)
    path = folder / f"Robot1_{name}.dat"
    content = path.read_text()
    path.write_text(f"{content}{line}\n")
    count = content.count("\n") + 1
    assert refusal(folder, tmp_path / "bag").startswith(f"import_mrclam: {path}, line {count}: ")


def test_missing_and_empty_files_are_named(tmp_path):
    folder = write_mrclam(tmp_path / "set", duration=2.0)
    path = folder / "Robot1_Groundtruth.dat"
    path.unlink()
    assert str(path) in refusal(folder, tmp_path / "bag")
    path.write_text("# nothing\n")
    assert "the times of odometry and ground truth do not overlap" in refusal(folder, tmp_path / "bag")


def refusal(folder, out):
    with pytest.raises(SystemExit) as ended:
        import_mrclam(folder, 1, out)
    assert not out.exists()
    text = str(ended.value.code)
    assert "\n" not in text
    assert len(text) < 400
    return text
