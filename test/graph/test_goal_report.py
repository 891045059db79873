"""Ends of goals in the recording of a robot: the report gives each goal its own end, and the live page agrees."""

import re

import bag_makers
import graph
import pytest
import watch_page
from diagnostic_msgs.msg import DiagnosticStatus
from robot import LATCHED, SIMULATED, distance, on_truth

from diffbot_tools.view.bag_source import read_bag
from diffbot_tools.view.report import page_data

PLANT = {"clock": "scaled", "real_time_factor": 5.0, "seed": 3}
FAR = (600.0, -600.0, 0.0)
A, B = (1.0, -4.0, 0.0), (-4.0, -3.0, 1.0)
PATH = (-1.5, -4.5, 0.0), (0.5, -3.5, 0.5)
RECORDED = {"/goal_pose", "/path", "/ground_truth", "/controller/status", "/controller/goal_results"}


def wait_for_motion(driven):
    before = driven.true_pose()
    driven.peer.spin_until(lambda: distance(before, driven.true_pose()) > 0.1, what="motion")


def drive_to_all_ends(driven):
    driven.cancel()  # now, so that the controller has discovered this client when it names who cancelled a goal
    driven.send_stamped(A)
    wait_for_motion(driven)
    for goals in ((B,), (B,), PATH):  # twice to the same pose
        assert driven.wait_for_end(driven.send_stamped(*goals))[0] == "reached"
    driven.send_stamped(FAR)
    wait_for_motion(driven)
    driven.cancel()
    assert driven.set_parameter("controller", "goal_timeout", 4.0).successful
    assert driven.wait_for_end(driven.send_stamped(FAR))[0] == "not reached"
    assert driven.set_parameter("controller", "goal_timeout", -1.0).successful
    driven.send_stamped(FAR)  # not reached before the live page is read
    wait_for_motion(driven)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """Return the bag of a drive, and the events of the live page that was open from its begin on."""
    folder = tmp_path_factory.mktemp("goals") / "bag"
    with (
        on_truth(PLANT, SIMULATED) as driven,
        graph.diffbot("watch", "--port", "0") as watch,
        graph.node("diffbot_bag.recorder_node", {"uri": str(folder), **SIMULATED}) as recorder,
    ):
        reports = driven.peer.subscribe(DiagnosticStatus, "/recorder/status", LATCHED)
        driven.peer.spin_until(
            lambda: any(set(graph.values(one)["topics"].split()) >= RECORDED for one in reports), what="the recorder"
        )
        watch.wait_for_output("Page: ")
        client = watch_page.Client(watch_page.url_of(watch))
        client.wait_for(lambda: client.state[2] == "idle", "the robot on the live page")
        client.close()
        drive_to_all_ends(driven)
        assert recorder.stop() == 0
        client = watch_page.Client(watch_page.url_of(watch))
        client.wait_for(lambda: client.events, "the events of the live page")
        client.close()
    return folder, client.events


def events_of(bag):
    (robot,) = page_data(read_bag(bag))["robots"]
    return [(kind, text) for _, kind, _, text in robot["events"] if kind in ("goal", "end")]


def test_each_goal_of_a_report_has_its_own_end_and_time(recorded):
    bag, _ = recorded
    (robot,) = page_data(read_bag(bag))["robots"]
    rows = robot["cards"]
    verdicts = [re.sub(r" \((sent by|after) .*| (after|in) [0-9.]+ s.*", "", row["verdict"]) for row in rows]
    assert verdicts == [
        *("Replaced: by a newer goal (goal_pose)", "Reached", "Reached", "Passed", "Reached"),
        "Cancelled: by a call of /controller/cancel from /peer or /watch_client",
        "Not reached within goal_timeout = 4 s",
        "No answer: the recording ends before",
    ]
    outcomes = read_bag(bag).robots[0].outcomes
    goals = [A, B, B, *PATH, FAR, FAR, FAR]
    assert [one.goal for one in outcomes] == [pytest.approx(goal, abs=1e-4) for goal in goals]
    results = {}
    for _, message in bag_makers.read(bag)["/controller/goal_results"]:
        for one in message.status:
            values = {pair.key: pair.value for pair in one.values}
            results[one.name] = one.message, float(values["elapsed time [s]"])
    # A path has one end, which is the end of its last pose.
    ended = [row for row in rows if row["end"] and row["end"] != "passed"]
    for row, (end, elapsed) in zip(ended, results.values(), strict=True):
        assert row["end"].startswith(end)
        # On a busy machine the recorder is late.
        assert elapsed - 0.06 <= float(re.search(r"([0-9.]+) s\)?$", row["verdict"])[1]) <= elapsed + 2.0
    ends = [re.sub(r"^goal |:? [\[(].*|: .*", "", text) for kind, text in events_of(bag) if kind == "end"]
    assert ends == [row["end"] for row in ended]


def test_the_live_page_lists_the_same_goals_and_ends(recorded):
    bag, live = recorded
    for kind in ("goal", "end"):
        # Either list may have any first of two messages with equal times.
        assert [text for _, one, _, text in live if one == kind] == [
            text for one, text in events_of(bag) if one == kind
        ]
