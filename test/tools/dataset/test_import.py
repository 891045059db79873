"""Data sets to bags: read back with the rosbags library, compared with the circle that the files describe."""

import math

import numpy as np
import pytest
import yaml
from bag_makers import read
from dataset_files import LANDMARKS, OMEGA, RADIUS, T0, measured, truth_at, write_labyrinth, write_mrclam
from robot import planar, stamp, turned

from diffbot_control.ros.messages.landmark_cloud import landmark_points
from diffbot_core.errors import DiffbotError
from diffbot_tools.dataset.command import import_labyrinth, import_mrclam

START = 1_248_446_190_000_000_000


def assert_pose(message, expected, tolerance=1e-7):
    pose = planar(message.pose.pose)
    assert pose[:2] == pytest.approx(expected[:2], abs=tolerance)
    assert turned(pose, expected) < 1e-7


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    folder = write_mrclam(tmp_path_factory.mktemp("data") / "MRCLAM_Dataset0", robot=3)
    out = folder.parent / "bag"
    assert import_mrclam(folder, 3, out) == 0
    return out


def test_bag_holds_odometry_landmarks_truth_and_start_at_the_time_of_the_data(bag):
    topics = read(bag)
    assert set(topics) == {"/odom", "/landmarks", "/ground_truth", "/initialpose"}
    for messages in topics.values():
        assert all(time == stamp(message) for time, message in messages)
    assert [len(topics[name]) for name in ("/odom", "/ground_truth", "/initialpose")] == [400, 1100, 1]
    assert topics["/odom"][7][0] == START + 350_000_000
    for time, message in topics["/ground_truth"]:
        assert message.header.frame_id == "map"
        assert_pose(message, truth_at((time - START) * 1e-9))
    time, message = topics["/initialpose"][0]
    assert time == topics["/odom"][0][0]
    assert_pose(message, truth_at(0.0))
    covariance = message.pose.covariance.reshape(6, 6)
    assert np.sqrt(covariance[[0, 1, 5], [0, 1, 5]]) == pytest.approx([0.01, 0.01, 0.01])


def test_odometry_carries_the_twist_and_unknown_covariances(bag):
    for index, (_, message) in enumerate(read(bag)["/odom"]):
        assert (message.header.frame_id, message.child_frame_id) == ("odom", "base_link")
        assert message.twist.twist.linear.x == pytest.approx(RADIUS * OMEGA)
        assert message.twist.twist.angular.z == pytest.approx(OMEGA)
        assert not message.twist.covariance.any()
        # Its own pose, in odom: along the circle from the origin.
        angle = OMEGA * 0.05 * index
        assert_pose(message, (RADIUS * math.sin(angle), RADIUS * (1.0 - math.cos(angle)), angle), 1e-4)


def test_landmarks_are_ranges_along_the_line_of_sight_by_subject(bag):
    """The files hold depths along the camera's axis."""
    clouds = read(bag)["/landmarks"]
    numbers = set()
    for time, message in clouds:
        assert message.header.frame_id == "base_link"
        for point in landmark_points(message):
            expected = measured((time - START) * 1e-9, point.number)
            assert (point.range, point.bearing) == pytest.approx(expected, abs=1e-6)
            assert (point.var_range, point.var_bearing) == (0.0, 0.0)
            numbers.add(point.number)
    assert numbers == set(LANDMARKS)
    steep = [abs(p.bearing) for _, message in clouds for p in landmark_points(message)]
    assert max(steep) > 1.0


def test_repeated_lines_are_left_out_and_a_landmark_twice_at_one_time_needs_two_clouds(tmp_path, capsys):
    folder = write_mrclam(tmp_path / "set")
    path = folder / "Robot1_Measurement.dat"
    path.write_text("".join(f"{T0 + 1:.3f} 63 {depth} 0.0\n" for depth in (2.0, 2.0, 2.5)))
    with (folder / "Robot1_Odometry.dat").open("a") as file:
        file.write(f"{T0:.3f} 9.0 9.0\n")
    import_mrclam(folder, 1, tmp_path / "bag")
    topics = read(tmp_path / "bag")
    assert [[p.range for p in landmark_points(m)] for _, m in topics["/landmarks"]] == [[2.0], [2.5]]
    assert max(message.twist.twist.linear.x for _, message in topics["/odom"]) < 1.0
    printed = capsys.readouterr().out
    assert "1 of 3 measurements are repetitions" in printed
    assert "1 of 401 odometry lines repeat a time" in printed


BAD_LINES = {
    "time": ("Robot1_Odometry.dat", "soon 0.1 0.1", "time 'soon' must be"),
    "range": ("Robot1_Measurement.dat", "1248446191 63 -1 0.1", "range '-1' must be"),
    "barcode twice": ("Barcodes.dat", "9 63", "barcode 63 is in the file twice"),
    "long word": ("Landmark_Groundtruth.dat", "1" * 5000 + " 1 1 0 0", "..."),
}


@pytest.mark.parametrize(("name", "line", "words"), BAD_LINES.values(), ids=BAD_LINES)
def test_bad_line_is_refused_with_file_line_and_value(tmp_path, name, line, words):
    folder = write_mrclam(tmp_path / "set", duration=2.0)
    path = folder / name
    count = len(path.read_text().splitlines())
    path.write_text(path.read_text() + line + "\n")
    with pytest.raises(DiffbotError) as caught:
        import_mrclam(folder, 1, tmp_path / "bag")
    assert f"{path}, line {count + 1}: " in str(caught.value)
    assert words in str(caught.value)
    assert len(str(caught.value)) < 400
    assert not (tmp_path / "bag").exists()


def test_labyrinth_has_ranges_without_bearing_and_positions_without_heading(tmp_path):
    folder = write_labyrinth(tmp_path / "labyrinth")
    import_labyrinth(folder, tmp_path / "bag")
    topics = read(tmp_path / "bag")
    time, message = topics["/landmarks"][4]
    (point,) = landmark_points(message)
    number = list(LANDMARKS)[5 % 3]
    assert point.number == 100 + number
    distance = math.dist(LANDMARKS[number], truth_at(time * 1e-9)[:2])
    assert (point.range, point.bearing, point.var_range) == pytest.approx((distance, 0.0, 0.01), abs=1e-6)
    assert point.var_bearing == math.inf
    truth = topics["/ground_truth"][0][1]
    assert truth.pose.covariance[35] == 1e6
    start = topics["/initialpose"][0][1]
    assert math.sqrt(start.pose.covariance[35]) == pytest.approx(math.pi / math.sqrt(3.0))
    twist = topics["/odom"][3][1].twist.twist
    assert (twist.linear.x, twist.angular.z) == pytest.approx((RADIUS * OMEGA, OMEGA), abs=1e-6)
    values = yaml.safe_load((tmp_path / "bag" / "ekf.yaml").read_text())["/**/ekf"]["ros__parameters"]
    assert values["wheel_separation"] == 0.08
    assert values["landmark_ids"] == [100 + n for n in (7, 8, 6)]
