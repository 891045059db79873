"""The result of a run in words: how each goal ended, what the filter was worth, which faults there were."""

import numpy as np
import pytest
import view_bags

from diffbot_control.law.presets import PRESETS
from diffbot_core.geometry import Pose
from diffbot_tools.view.events import ERROR, OK, WARNING, Event, GoalSent
from diffbot_tools.view.report import page_data, read_bag_run
from diffbot_tools.view.result import goal_rows, health_lines

TUNED = PRESETS["tuned"]
TIME = np.linspace(0.0, 10.0, 101)


def drive(end_x, speed=0.2, truth=True):
    """Return curves from x = 0 to ``end_x`` within 5 s, where the robot then stays."""
    path = {"t": TIME, "x": np.clip(TIME / 5.0, 0.0, 1.0) * end_x, "y": 0.0 * TIME, "theta": 0.0 * TIME}
    command = {"t": TIME, "v": np.full(101, speed), "omega": np.full(101, -0.5)}
    return {"truth" if truth else "estimate": path, "command": command, "law": {"t": TIME}}


def row_of(curves, *events, config=TUNED):
    (row,) = goal_rows(curves, [GoalSent(0.5, Pose(2.0, 0.0, 0.0))], list(events), config)
    return row


def end(time, text):
    return Event(time, "end", OK, f"goal {text}")


def test_a_goal_that_was_reached_with_its_figures_at_the_answer():
    curves = drive(2.0)
    curves["truth"]["x"][80:] = 50.0  # a reset of the simulation after the answer
    row = row_of(curves, end(6.5, "reached [request]"))
    assert (row["level"], row["verdict"]) == (OK, "Reached in 6.0 s")
    limits = f"Limits kept: 0.20 of {TUNED.data_sheet.v_max:.2f} m/s, 0.50 of {TUNED.data_sheet.omega_max:.2f} rad/s"
    assert row["lines"] == [(OK, "True error 0.0 cm, 0.0 deg"), (OK, "Path 1.80 m, straight line 1.80 m"), (OK, limits)]


def test_an_answer_that_the_truth_contradicts_is_an_error():
    row = row_of(drive(1.5), end(6.5, "reached [request]"))
    assert (row["level"], row["verdict"]) == (ERROR, "Reported reached in 6.0 s, but off the goal")
    assert row["lines"][0] == (ERROR, "True error 50.0 cm, 0.0 deg")
    assert row_of(drive(1.5, truth=False), end(6.5, "reached"))["lines"][0][1].startswith("Estimated error 50.0 cm")


@pytest.mark.parametrize(
    ("text", "level", "verdict"),
    [
        ("not reached: no progress for 10 s [request]", ERROR, "Not reached: no progress for 10 s (after 4.0 s)"),
        ("cancelled [request]", OK, "Cancelled after 4.0 s"),
    ],
)
def test_other_ends(text, level, verdict):
    row = row_of(drive(1.5), end(4.5, text))
    assert (row["level"], row["verdict"]) == (level, verdict)
    # From the last pose, with what was driven until then.
    assert row["lines"][0] == (OK, "True error 50.0 cm, 0.0 deg")


def test_without_an_answer():
    assert row_of(drive(1.5))["verdict"] == "No answer: the recording ends before"
    goals = [GoalSent(0.5, Pose(2.0, 0.0, 0.0)), GoalSent(5.0, Pose(0.0, 0.0, 0.0))]
    rows = goal_rows(drive(1.5), goals, [], TUNED)
    assert [row["level"] for row in rows] == [WARNING, WARNING]
    assert rows[0]["verdict"] == "No answer in the recording"


def test_commands_beyond_a_limit_are_an_error():
    row = row_of(drive(2.0, speed=1.01 * TUNED.data_sheet.v_max), end(6.5, "reached"))
    level, text = row["lines"][2]
    assert level == ERROR
    assert text.startswith("BEYOND LIMITS: 1.31 of 1.30 m/s")


def test_a_consistent_filter_and_an_overconfident_one():
    bound = 9.35
    for share, level, word in ((0.95, OK, "consistent"), (0.5, ERROR, "overconfident")):
        nees = np.where(np.arange(100) < 100 * share, 3.0, 20.0)
        first, *_ = health_lines({"error": {"nees": nees}}, [], bound, 0, False)
        assert first[0] == level
        assert f"filter {word}: NEES below its 95 % bound {100 * share:.0f} %" in first[1]


def test_losses_and_faults_are_named_the_worst_first():
    events = [
        Event(0.1, "fault", WARNING, "ekf: no fix yet"),  # while it starts
        Event(0.5, "goal", OK, "goal 1"),
        Event(1.0, "fault", WARNING, "plant: slow"),
        Event(2.0, "state", ERROR, "controller: stale pose"),
        Event(3.0, "state", ERROR, "controller: goal not reached"),
    ]
    found = health_lines({}, events, 9.35, 7, True)
    assert found == [
        (WARNING, "recording cut off: the bag was not closed"),
        (WARNING, "7 messages lost"),
        (ERROR, "faults: controller: stale pose; plant: slow"),
    ]
    # Nodes that end one after the other miss each other, until which the run was whole.
    end = [Event(5.0, "state", OK, "controller: inactive"), Event(5.0, "state", ERROR, "ekf: no odometry")]
    assert health_lines({}, [*events, *end], 9.35, 7, True) == found
    assert health_lines({}, [], 9.35, 0, False) == [(OK, "no message lost"), (OK, "no fault reported")]


def test_a_bag_without_its_end_says_so(tmp_path, circle):
    killed = view_bags.write(tmp_path / "bag", view_bags.drive(50))
    (killed / "metadata.yaml").unlink()
    for path, is_told in ((killed, True), (circle, False)):
        (robot,) = page_data(read_bag_run(path))["robots"]
        assert any("cut off" in text for _, text in robot["health"]) is is_told
