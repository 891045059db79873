"""Data of a report: curves, goals and events of complete bags, of bags with few topics, and of bags of other robots."""

import json
import math

import numpy as np
import pytest
import view_bags
from evo.tools import file_interface
from hypothesis import given
from hypothesis import strategies as st

from diffbot_bag.writer import new_bag
from diffbot_core.errors import DiffbotError
from diffbot_tools import cli
from diffbot_tools.view.bag_source import read_bag
from diffbot_tools.view.report import export, kept_rows, page_data

BEGIN, DELAY = view_bags.BEGIN, view_bags.DELAY


@pytest.fixture(scope="module")
def run_of_circle(circle):
    return read_bag(circle)


def bag(folder, messages):
    return view_bags.write(folder / "bag", messages)


def only_robot(path):
    (robot,) = read_bag(path).robots
    return robot


def test_errors_and_nees_have_the_values_of_the_bag_and_odometry_begins_at_the_truth(run_of_circle):
    curves = run_of_circle.robots[0].curves
    for name in ("x", "y"):
        assert curves["odometry"][name] == pytest.approx(curves["truth"][name], abs=1e-9)
    error = curves["error"]
    assert len(error["t"]) == 500
    assert error["x"] == pytest.approx(np.full(500, 0.03), abs=1e-9)
    assert error["y"] == pytest.approx(np.full(500, -0.02), abs=1e-9)
    assert error["theta"] == pytest.approx(np.full(500, 0.01), abs=1e-9)
    assert error["three_sigma_y"] == pytest.approx(np.full(500, 0.15))
    assert error["nees"] == pytest.approx(np.full(500, (0.03**2 + 0.02**2 + 0.01**2) / 0.05**2))


def test_events_are_listed_in_the_order_of_time(run_of_circle):
    events = run_of_circle.robots[0].all_events
    assert [event.time for event in events] == sorted(event.time for event in events)
    found = {(event.kind, event.text): event for event in events}
    times = {
        ("goal", "goal 1: x 1.00 m, y 0.50 m, 14 deg"): DELAY * 1e-9,
        ("goal", "goal 2: x 2.00 m, y 0.50 m, 14 deg"): 5.0 + DELAY * 1e-9,
        ("switch", "region Omega_L"): 5.0,
        ("switch", "region Omega_G"): 499 / 50,
    }
    assert {key: found[key].time for key in times} == pytest.approx(times)
    assert found["rejection", "fixes rejected: 1 more, 1 in all"].level == 1
    assert found["end", "goal reached [goal_pose]"].level == 0
    (failed,) = [event for event in events if event.text.startswith("goal not reached")]
    assert failed.level == 2
    assert [event.text for event in events if event.kind == "state"] == ["ekf: running", "controller: driving"]


def test_a_corrected_goal_is_one_goal_with_its_last_pose(tmp_path):
    first = {"goal_id": "a" * 32}
    corrections = [{"goal": f"1.{n} 2.{n} 0.4", "goal updates": f"{n}"} | first for n in (1, 5, 9)]

    def messages():
        for second, values in enumerate(
            [{"goal": "1 2 0.5"} | first, *corrections, {"goal": "-3 0 0", "goal_id": "b" * 32}]
        ):
            time = BEGIN + second * 10**9
            yield "/odom", time, view_bags.odometry(time, 0.0, 0.0, 0.0)
            yield "/controller/status", time, view_bags.status("/controller", "driving", **values)

    found = [(goal.time, tuple(goal.pose)) for goal in only_robot(bag(tmp_path, messages())).model.goals.goals]
    assert found == [(0.0, (1.9, 2.9, 0.4)), (4.0, (-3.0, 0.0, 0.0))]


def test_without_poses_the_path_is_computed_from_transforms(tmp_path):
    def messages():
        for step in range(10):
            time = BEGIN + step * 10**8
            edges = [("odom", "base_link", 0.1 * step, 0.0, 0.0), ("base_link", "wheel", 0.0, 0.3, 1.0)]
            if step % 5 == 0:
                edges.append(("map", "odom", 1.0, 2.0, math.pi / 2))
            yield "/tf", time, view_bags.transforms(time, *edges)

    path = only_robot(bag(tmp_path, messages())).curves["estimate"]
    assert path["x"] == pytest.approx(np.full(10, 1.0))
    assert path["y"] == pytest.approx(2.0 + 0.1 * np.arange(10))
    assert path["theta"] == pytest.approx(np.full(10, math.pi / 2))


def test_a_bag_with_other_topic_names_gives_the_same_curves_with_remap(tmp_path, kept_signal_handlers, capsys):
    other = {"/odom": "/base/wheels", "/ground_truth": "/mocap"}
    usual, renamed = tmp_path / "usual", tmp_path / "renamed"
    for path, names in ((usual, {}), (renamed, other)):
        view_bags.write(path, ((names.get(topic, topic), *rest) for topic, *rest in view_bags.drive(40)))
    (expected,) = read_bag(usual).robots
    (found,) = read_bag(renamed, remap={name.lstrip("/"): topic for name, topic in other.items()}).robots
    for curve in ("odometry", "truth", "error"):
        assert found.curves[curve]["x"] == pytest.approx(expected.curves[curve]["x"], abs=0.0), curve
    assert cli.main(["report", str(renamed), "--remap", "odom:=/mocap", "ground_truth:=/none"]) == 1
    assert "--remap: /none is not in the bag; ground_truth must be" in capsys.readouterr().err


def test_each_namespace_with_a_pose_is_a_robot(tmp_path):
    streams = [view_bags.drive(40, namespace=f"/robot{number}") for number in (1, 2)]
    found = read_bag(bag(tmp_path, (message for pair in zip(*streams, strict=True) for message in pair)))
    assert [robot.name for robot in found.robots] == ["robot1", "robot2"]
    for robot in found.robots:
        assert len(robot.curves["error"]["t"]) == 40
        assert len(robot.outcomes) == 2


def test_a_report_that_cannot_be_made_is_refused_in_one_line(circle, tmp_path, capsys):
    no_pose = bag(tmp_path, [("/odom", BEGIN, view_bags.odometry(BEGIN, math.nan, 0.0, 0.0))])
    for path, out, words in (
        (no_pose, tmp_path / "a.html", "has no pose of a robot"),
        (circle, tmp_path / "a.txt", "must end with .html"),
        (circle, tmp_path / "none" / "a.html", "does not exist"),
    ):
        assert cli.main(["report", str(path), "--out", str(out)]) == 1
        error = capsys.readouterr().err
        assert words in error
        assert error.count("\n") == 1
    assert list(tmp_path.iterdir()) == [no_pose]


def test_the_report_of_a_bag_with_a_dot_in_its_name_has_the_whole_name(tmp_path, capsys):
    path = view_bags.write(tmp_path / "run.1", view_bags.drive(20))
    assert cli.main(["report", str(path)]) == 0
    assert capsys.readouterr().out == f"Report {tmp_path / 'run.1.html'}\n"


def bag_with_parameters(folder, parameters):
    channels = {}
    with new_bag(folder) as writer:
        for topic, time, message in view_bags.drive(20):
            if topic not in channels:
                channels[topic] = writer.add_topic(topic, message[0])
            writer.write(channels[topic], view_bags.data_of(message), time, time)
        writer.attach("parameters.json", "application/json", json.dumps({"/controller": parameters}).encode())


def test_tolerances_and_limits_are_taken_from_the_recorded_parameters(tmp_path):
    recorded = {
        "xy_goal_tolerance": 0.25,
        "linear.x.max_velocity": 0.4,
        "angular.z.max_velocity": "inf",
        "autostart": 1,
    }
    bag_with_parameters(tmp_path / "bag", recorded)
    (robot,) = page_data(read_bag(tmp_path / "bag"))["robots"]
    assert robot["constants"]["xy_tolerance"] == 0.25
    assert robot["constants"]["limits"] == {"v": 0.4, "omega": None}
    bag_with_parameters(tmp_path / "bad", {"xy_goal_tolerance": "wide"})
    with pytest.raises(DiffbotError, match="xy_goal_tolerance = 'wide'"):
        read_bag(tmp_path / "bad")


def test_csv_and_tum_files_have_the_values_of_the_curves(circle, run_of_circle, tmp_path):
    written = export(run_of_circle, tmp_path / "run.html", csv=True, tum=True)
    assert {path.name for path in written} == {
        "run.csv", "run_truth.tum", "run_estimate.tum", "run_odometry.tum",
    }  # fmt: skip
    trajectory = file_interface.read_tum_trajectory_file(tmp_path / "run_truth.tum")
    _, x, y, _ = view_bags.at(100)
    assert trajectory.timestamps[100] == pytest.approx((BEGIN + 2 * 10**9) * 1e-9, abs=1e-6)
    assert trajectory.positions_xyz[100, :2] == pytest.approx([x, y], abs=1e-6)
    table = np.genfromtxt(tmp_path / "run.csv", delimiter=",", names=True, deletechars="")
    assert table["error.x"][7] == pytest.approx(0.03)
    assert table["law.rho"][250] == pytest.approx(1.5)


def test_robots_whose_files_would_have_the_same_name_are_refused_and_no_file_is_written(tmp_path):
    streams = [view_bags.drive(10, namespace=namespace) for namespace in ("/a/b", "/a_b")]
    found = read_bag(bag(tmp_path, (message for pair in zip(*streams, strict=True) for message in pair)))
    with pytest.raises(DiffbotError, match="files of the same name"):
        export(found, tmp_path / "run.html", csv=True, tum=True)
    assert not list(tmp_path.glob("run*"))


@given(st.integers(0, 2**32), st.integers(100, 5000), st.floats(0.0, 0.9))
def test_thinning_keeps_the_peaks_of_every_column_whatever_values_are_missing(seed, n, missing):
    rng = np.random.default_rng(seed)
    columns = np.where(rng.random((n, 3)) < missing, np.nan, rng.normal(size=(n, 3)))
    places = rng.choice(n, 6, replace=False)
    for index, place in enumerate(places):
        columns[place, index % 3] = 100.0 * (-1) ** (index // 3)
    kept = kept_rows(columns, 90)
    assert len(kept) <= 90
    assert set(places) <= set(kept.tolist())
    assert (kept[0], kept[-1]) == (0, n - 1)
    assert np.all(np.diff(kept) > 0)
