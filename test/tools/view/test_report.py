"""What a report says of a bag: curves, goals, events and topics, of complete, poor, foreign and hostile bags."""

import json
import math

import numpy as np
import pytest
import view_bags
from evo.tools import file_interface

from diffbot_bag.bag.new_bag import new_bag
from diffbot_control.law.presets import PRESETS
from diffbot_core.errors import DiffbotError
from diffbot_tools.view.events import MAX_NAMES, EventMaker
from diffbot_tools.view.exports import export
from diffbot_tools.view.page_file import embedded_json
from diffbot_tools.view.report import page_data, read_bag_run
from diffbot_tools.view.report_command import ReportOptions, run
from diffbot_tools.view.texts import Status

BEGIN, DELAY = view_bags.BEGIN, view_bags.DELAY


@pytest.fixture(scope="module")
def run_of_circle(circle):
    return read_bag_run(circle)


def bag(folder, messages):
    return view_bags.write(folder / "bag", messages)


def only_robot(path):
    (robot,) = read_bag_run(path).robots
    return robot


def test_errors_and_nees_are_those_that_were_put_in_and_odometry_begins_at_the_truth(run_of_circle):
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


def test_events_in_the_order_of_time(run_of_circle):
    events = run_of_circle.robots[0].events
    assert [event.time for event in events] == sorted(event.time for event in events)
    found = {(event.kind, event.text): event for event in events}
    times = {
        ("goal", "goal 1: x 1.00 m, y 0.50 m, 14 deg"): DELAY * 1e-9,
        ("goal", "goal 2: x 2.00 m, y 0.50 m, 14 deg"): 5.0,
        ("switch", "region Omega_L"): 5.0,
        ("switch", "region Omega_G"): 499 / 50,
    }
    assert {key: found[key].time for key in times} == pytest.approx(times)
    assert found["rejection", "fixes rejected: 1 more, 1 in all"].level == 1
    assert found["end", "goal reached [goal_pose]"].level == 0
    (failed,) = [event for event in events if event.text.startswith("goal not reached")]
    assert failed.level == 2
    assert [event.text for event in events if event.kind == "state"] == ["ekf: running", "controller: driving"]


def test_topics_with_rates_and_delays(run_of_circle):
    data = page_data(run_of_circle)
    topics = {topic["name"]: topic for topic in data["topics"]}
    pose = topics["/pose"]
    assert (pose["count"], pose["rate"], pose["gap"]) == (500, pytest.approx(50.0), pytest.approx(0.02))
    assert (pose["delay"], pose["delay99"]) == (pytest.approx(0.002), pytest.approx(0.002))
    assert "delay" not in topics["/cmd_vel"]
    assert data["messages"] == sum(topic["count"] for topic in data["topics"])


def test_a_long_bag_is_thinned(run_of_circle, monkeypatch):
    monkeypatch.setattr("diffbot_tools.view.report.MAX_ROWS", 200)
    curves = page_data(run_of_circle)["robots"][0]["curves"]
    assert 20 < curves["truth"]["rows"] <= 200


def goals_of_statuses(folder, *statuses):
    """Return (time, pose) of the goals in a bag without goal messages: its controller reports these, one a second."""

    def messages():
        for second, values in enumerate(statuses):
            time = BEGIN + second * 10**9
            yield "/odom", time, view_bags.odometry(time, 0.0, 0.0, 0.0)
            yield "/controller/status", time, view_bags.status("/controller", "driving", **values)

    return [(goal.time, tuple(goal.pose)) for goal in only_robot(bag(folder, messages())).goals]


def test_goals_of_a_service_come_from_the_status(tmp_path):
    found = goals_of_statuses(tmp_path, *({"goal": goal} for goal in ("1 2 0.5", "1 2 0.5", "-3 0 0", "nonsense")))
    assert found == [(0.0, (1.0, 2.0, 0.5)), (2.0, (-3.0, 0.0, 0.0))]


def test_a_corrected_goal_has_its_last_pose_and_is_none_of_its_own(tmp_path):
    shown = [{"goal": "1 2 0.5"}, *({"goal": f"1.{n} 2.{n} 0.4", "goal updates": f"{n}"} for n in (1, 5, 9))]
    found = goals_of_statuses(tmp_path, *shown, {"goal": "-3 0 0"})
    assert found == [(0.0, (1.9, 2.9, 0.4)), (4.0, (-3.0, 0.0, 0.0))]


def test_only_transforms(tmp_path):
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


def test_two_robots(tmp_path):
    streams = [view_bags.drive(40, namespace=f"/robot{number}") for number in (1, 2)]
    found = read_bag_run(bag(tmp_path, (message for pair in zip(*streams, strict=True) for message in pair)))
    assert [robot.name for robot in found.robots] == ["robot1", "robot2"]
    for robot in found.robots:
        assert len(robot.curves["error"]["t"]) == 40
        assert len(robot.goals) == 2


def test_log_times_of_another_clock(tmp_path):
    """Stamps of a simulation, log times of the wall."""
    messages = ((topic, time + 10**15, message) for topic, time, message in view_bags.drive(20))
    robot = only_robot(bag(tmp_path, messages))
    assert robot.curves["command"]["t"][0] == pytest.approx(0.0, abs=1e-6)
    assert [event.time for event in robot.events if event.kind == "state"] == pytest.approx([0.0, 0.0], abs=1e-3)


def test_what_cannot_be_reported_is_one_line(circle, tmp_path):
    no_pose = bag(tmp_path, [("/odom", BEGIN, view_bags.odometry(BEGIN, math.nan, 0.0, 0.0))])
    for path, out, words in (
        (no_pose, tmp_path / "a.html", "no pose"),
        (tmp_path / "none", tmp_path / "a.html", "no bag"),
        (circle, tmp_path / "a.txt", "must end with .html"),
        (circle, tmp_path / "no" / "a.html", "no folder"),
    ):
        with pytest.raises(DiffbotError, match=words) as error:
            run(ReportOptions(path, out, "tuned"))
        assert "\n" not in str(error.value)
    with pytest.raises(DiffbotError, match="4 bags: must be at most 3"):
        run(ReportOptions(circle, tmp_path / "a.html", None, others=(circle,) * 3))
    assert list(tmp_path.iterdir()) == [no_pose]


def bag_with_parameters(folder, noted):
    channels = {}
    with new_bag(folder) as writer:
        for topic, time, message in view_bags.drive(20):
            if topic not in channels:
                channels[topic] = writer.add_topic(topic, message[0])
            writer.write(channels[topic], view_bags.data_of(message), time, time)
        writer.attach("parameters.json", "application/json", json.dumps({"/controller": noted}).encode())


def test_tolerances_and_limits_are_those_that_the_recorder_noted(tmp_path):
    noted = {"xy_goal_tolerance": 0.25, "linear.x.max_velocity": 0.4, "angular.z.max_velocity": "inf", "autostart": 1}
    bag_with_parameters(tmp_path / "bag", noted)
    (robot,) = page_data(read_bag_run(tmp_path / "bag"))["robots"]
    assert robot["constants"]["xy_tolerance"] == 0.25
    assert robot["constants"]["limits"] == {"v": 0.4, "omega": None}
    paper = PRESETS["paper"]
    (robot,) = page_data(read_bag_run(tmp_path / "bag", paper))["robots"]
    assert robot["constants"]["xy_tolerance"] == paper.tolerance.xy_goal_tolerance != 0.25
    bag_with_parameters(tmp_path / "bad", {"xy_goal_tolerance": "wide"})
    with pytest.raises(DiffbotError, match="xy_goal_tolerance = 'wide'"):
        read_bag_run(tmp_path / "bad")


def test_files_beside_the_report(circle, run_of_circle, tmp_path):
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


def test_a_status_that_names_the_goal_before_is_no_goal(tmp_path):
    def messages():
        for step, name in enumerate((1, 2)):
            time = BEGIN + 10**10 * step
            yield "/odom", time, view_bags.odometry(time, 0.0, 0.0, 0.0)
            yield "/goal_pose", time, view_bags.goal(time, float(name), 0.0, 0.0)
            for late, goal in ((3, max(step, 1)), (6, name)):
                status = view_bags.status("/controller", "driving", goal=f"{goal} 0 0")
                yield "/controller/status", time + late * 10**8, status

    assert [goal.pose.x for goal in only_robot(bag(tmp_path, messages())).goals] == [1.0, 2.0]


def test_stamps_that_jump_are_an_event(tmp_path):
    def messages(jump):
        for step in range(50):
            time = BEGIN + step * 10**8
            yield "/odom", time, view_bags.odometry(time + (step >= 30) * jump, 0.1 * step, 0.0, 0.0)

    for seconds, words in ((-30, ["stamps of odometry jumped by -30.0 s"]), (0, [])):
        folder = tmp_path / str(seconds)
        folder.mkdir()
        events = only_robot(bag(folder, messages(seconds * 10**9))).events
        assert [event.text for event in events] == words


def test_runs_that_are_compared_begin_with_their_first_goal(tmp_path):
    def messages(before):
        yield from [("/odom", BEGIN, view_bags.odometry(BEGIN, 0.0, 0.0, 0.0))]
        for second in (before, before + 3):
            time = BEGIN + second * 10**9
            yield "/odom", time, view_bags.odometry(time, second - before, 0.0, 0.0)
            yield "/goal_pose", time, view_bags.goal(time, 3.0, 0.0, 0.0)

    runs = [
        read_bag_run(view_bags.write(tmp_path / name, messages(before)), is_from_goal=True)
        for name, before in (("a", 2), ("b", 7))
    ]
    data = page_data(*runs)
    assert [robot["name"].split(": ")[0] for robot in data["robots"]] == ["1", "2"]
    assert [[goal[0] for goal in robot["goals"]] for robot in data["robots"]] == [[0.0, 3.0], [0.0, 3.0]]
    assert [run.robots[0].curves["odometry"]["t"].tolist() for run in runs] == [[-2.0, 0.0, 3.0], [-7.0, 0.0, 3.0]]
    assert data["span"] == pytest.approx([-7.0, 3.0], abs=2e-3)


def test_nothing_in_the_data_can_end_its_element():
    text = embedded_json({"a": view_bags.HOSTILE, "b": "<!--"})
    assert "<" not in text
    assert text.isascii()
    assert json.loads(text)["a"] == view_bags.HOSTILE


def test_a_node_that_reports_on_keeps_its_fault_among_any_number_of_names():
    maker, fault = EventMaker(), Status(2, "/ekf", "broken", {})
    assert len(maker.of_diagnostics(0.0, [fault])) == 1
    for number in range(3 * MAX_NAMES):
        others = [Status(0, f"/other{number}", "ok", {})]
        results = [Status(0, f"goal {number}", "reached", {})]
        counters = Status(0, "/ekf", "ok", {f"fix{number} rejected": "1"})
        maker.of_results(1.0, results)
        maker.of_status(1.0, "filter", counters)
        assert maker.of_diagnostics(1.0, [*others, fault]) == []
    assert all(len(one) <= MAX_NAMES for one in vars(maker).values() if hasattr(one, "__len__"))
