"""Results of a bag in words: ends of goals, consistency of the filter, losses, faults and docking."""

import numpy as np
import pytest
import view_bags

from diffbot_control.law.registry import PRESETS
from diffbot_core.geometry import Pose
from diffbot_tools.view.bag_source import read_bag
from diffbot_tools.view.events import Event
from diffbot_tools.view.goal_list import Goal
from diffbot_tools.view.report import page_data
from diffbot_tools.view.results import NEUTRAL, cards_of, health_lines, outcomes_of, result_line
from diffbot_tools.view.texts import ERROR, OK, WARNING, Status
from diffbot_tools.view.words import RobotSituation, docking_words, state_words

TUNED = PRESETS["tuned"].config
TIME = np.linspace(0.0, 10.0, 101)


def drive(end_x, speed=0.2, truth=True):
    """Return curves from x = 0 to ``end_x`` within 5 s, where the robot then stays."""
    path = {"t": TIME, "x": np.clip(TIME / 5.0, 0.0, 1.0) * end_x, "y": 0.0 * TIME, "theta": 0.0 * TIME}
    command = {"t": TIME, "v": np.full(101, speed), "omega": np.full(101, -0.5)}
    return {"truth" if truth else "estimate": path, "command": command, "law": {"t": TIME}}


def card_of(curves, *end, config=TUNED):
    (card,) = cards_of(outcomes_of([goal(0.5, 2.0, *end)], curves), curves, config)
    return card


def goal(time, x, end="", reason="", source="", ended=np.nan):
    return Goal(time, Pose(x, 0.0, 0.0), end=end, reason=reason, source=source, ended=ended)


def test_figures_of_a_reached_goal_are_taken_at_its_answer():
    curves = drive(2.0)
    curves["truth"]["x"][80:] = 50.0  # a reset of the simulation after the answer
    card = card_of(curves, "reached", "", "request", 6.5)
    assert (card["level"], card["verdict"], card["time"]) == (OK, "Reached in 6.0 s", 6.0)
    error = (OK, "True error at the answer 0.0 cm, 0.0 deg")
    assert card["lines"] == [error, (OK, "Path 1.80 m, straight line 1.80 m"), (OK, "Limits kept")]


def test_an_answer_that_the_truth_contradicts_is_an_error():
    card = card_of(drive(1.5), "reached", "", "request", 6.5)
    assert (card["level"], card["verdict"]) == (ERROR, "Reported reached in 6.0 s, but off the goal")
    assert card["lines"][0] == (ERROR, "True error at the answer 50.0 cm, 0.0 deg")
    estimated = card_of(drive(1.5, truth=False), "reached", "", "", 6.5)
    assert estimated["lines"][0][1].startswith("Estimated error at the answer 50.0 cm")


@pytest.mark.parametrize(
    ("end", "reason", "level", "verdict"),
    [
        ("not reached", "no progress for 10 s", ERROR, "Not reached: no progress for 10 s (after 4.0 s)"),
        ("not reached", "not reached within 4 s", ERROR, "Not reached within 4 s (after 4.0 s)"),
        ("cancelled", "", NEUTRAL, "Cancelled (sent by action) after 4.0 s"),
        ("replaced", "by a newer goal (goal_pose)", NEUTRAL, "Replaced: by a newer goal (goal_pose) after 4.0 s"),
    ],
)
def test_the_verdict_names_end_reason_sender_and_time(end, reason, level, verdict):
    card = card_of(drive(1.5), end, reason, "action", 4.5)
    assert (card["level"], card["verdict"]) == (level, verdict)
    assert (OK, "True error at the answer 65.0 cm, 0.0 deg") in card["lines"]


def test_goals_without_an_answer_are_warnings():
    assert card_of(drive(1.5))["verdict"] == "No answer: the recording ends before"
    curves = drive(1.5)
    cards = cards_of(outcomes_of([goal(0.5, 2.0), goal(5.0, 0.0)], curves), curves, TUNED)
    assert [card["level"] for card in cards] == [WARNING, WARNING]
    assert cards[0]["verdict"] == "No answer in the recording"
    assert result_line(cards) == (OK, "0 of 2 goals reached")


def test_the_title_names_goals_that_were_cancelled_or_replaced():
    ends = "replaced", "reached", "cancelled", "replaced"
    cards = [card_of(drive(2.0), end, "", "action", 6.5) for end in ends]
    assert result_line(cards) == (OK, "1 of 4 goals reached, 2 replaced, 1 cancelled")


def test_commands_beyond_a_limit_are_an_error():
    card = card_of(drive(2.0, speed=1.01 * TUNED.data_sheet.v_max), "reached", "", "", 6.5)
    level, text = card["lines"][2]
    assert level == ERROR
    assert text.startswith("Limits exceeded: 1.31 of 1.30 m/s")


def test_a_filter_is_trustworthy_if_its_nees_is_rarely_above_the_bound():
    for share, level, word in ((0.95, OK, "trustworthy"), (0.5, ERROR, "overconfident")):
        nees = np.where(np.arange(100) < 100 * share, 3.0, 20.0)
        first, *_ = health_lines({"error": {"nees": nees}}, [], 0, False)
        assert first[0] == level
        assert first[1] == f"filter: {word} (NEES below its 95 % bound {100 * share:.0f} % of the time)"


def test_losses_and_faults_are_named_the_worst_first():
    events = [
        Event(0.1, "fault", WARNING, "ekf: no fix yet"),  # while nodes start
        Event(0.5, "goal", OK, "goal 1"),
        Event(1.0, "fault", WARNING, "ekf: 1 message dropped"),  # while nodes start
        Event(3.0, "fault", WARNING, "plant: slow"),
        Event(3.0, "state", ERROR, "controller: stale pose"),
        Event(3.0, "state", ERROR, "controller: goal not reached"),
    ]
    found = health_lines({}, events, 7, True)
    assert found == [
        (WARNING, "recording cut off: the bag was not closed"),
        (WARNING, "7 messages lost"),
        (ERROR, "faults: controller: stale pose; plant: slow"),
    ]
    # Nodes that end one after the other report that messages of the others are missing. These are not faults.
    end = [Event(5.0, "state", OK, "controller: inactive"), Event(5.0, "state", ERROR, "ekf: no odometry")]
    assert health_lines({}, [*events, *end], 7, True) == found
    assert health_lines({}, [], 0, False) == [(OK, "no message lost"), (OK, "no fault reported")]


def test_a_bag_that_was_not_closed_is_reported_as_cut_off(tmp_path):
    killed = view_bags.write(tmp_path / "bag", view_bags.drive(50))
    (killed / "metadata.yaml").unlink()
    (robot,) = page_data(read_bag(killed))["robots"]
    assert robot["health"][1] == (WARNING, "recording cut off: the bag was not closed")


def test_the_state_line_shows_docking_until_the_robot_drives_again():
    def words(before, message, **values):
        return docking_words(Status(0, "dock_controller", message, values), before)

    approaching = words(None, "driving", goal="0 0 0", phase="approaching")
    assert approaching == (OK, "docking: approaching")
    docked = words(approaching, "goal reached")
    assert docked == words(docked, "idle") == (OK, "docked")
    out = words(docked, "driving", goal="-0.7 0 0", phase="leaving")
    assert out == (OK, "undocking: leaving")
    assert words(out, "goal reached") is None
    idle = Status(0, "controller", "idle", {})
    assert state_words(RobotSituation(idle, docking=docked), 0.1) == (OK, "docked")
    assert state_words(RobotSituation(idle), 0.1) == (OK, "idle")
