"""Ends of goals in the recording of a robot: the report gives each goal its own end, and the live page agrees."""

import re

import bag_makers
import graph
import pytest
import watch_page
from action_msgs.msg import GoalStatusArray
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from nav_msgs.msg import Path
from robot import DEEP, LATCHED, SIMULATED, distance, on_truth, pose_stamped, stamped_goal

from diffbot_tools.view.bag_source import read_bag
from diffbot_tools.view.report import page_data

PLANT = {"clock": "scaled", "real_time_factor": 5.0, "seed": 3}
FAR = (600.0, -600.0, 0.0)
A, B = (1.0, -4.0, 0.0), (-4.0, -3.0, 1.0)
PATH = (-1.5, -4.5, 0.0), (0.5, -3.5, 0.5)


class Session:
    """A robot, and what its controller publishes about goals."""

    def __init__(self, driven):
        self.driven, self.peer = driven, driven.peer
        self.states = self.peer.subscribe(GoalStatusArray, "controller/goal_status", LATCHED)
        self.results = self.peer.subscribe(DiagnosticArray, "controller/goal_results", LATCHED)
        self.reports = self.peer.subscribe(DiagnosticStatus, "/recorder/status", LATCHED)
        self.statuses = self.peer.subscribe(DiagnosticStatus, "controller/status", DEEP)
        self.paths = self.peer.publisher(Path, "path")
        driven.cancel()  # now, so that the controller has discovered this client when it names who cancelled a goal

    def wait_for_recorder(self):
        """Wait until the recorder receives all topics that a report needs."""
        wanted = {"/goal_pose", "/ground_truth", "/controller/status", "/controller/goal_results"}
        self.peer.spin_until(
            lambda: any(wanted <= set(graph.values(one)["topics"].split()) for one in self.reports),
            what="the recorder",
        )
        before = len(self.statuses)
        self.peer.spin_until(lambda: len(self.statuses) > before + 1, what="two statuses")

    def newest_goal(self):
        """Return the id of the goal that was accepted last."""
        states = self.states[-1].status_list if self.states else []
        return bytes(states[-1].goal_info.goal_id.uuid).hex() if states else ""

    def send(self, *goals):
        """Send a goal or a path twice, which is one goal, and wait until the controller has accepted it."""
        goal_id, message = stamped_goal(*goals)
        publisher = self.driven.goals if len(goals) == 1 else self.paths
        self.peer.wait_for_subscribers(publisher)
        publisher.publish(message)
        publisher.publish(message)
        self.peer.spin_until(lambda: self.newest_goal() == goal_id, what="the goal")

    def wait_for_motion(self):
        """Wait until the robot is 0.1 m away from here."""
        before = self.driven.true_pose()
        self.peer.spin_until(lambda: distance(before, self.driven.true_pose()) > 0.1, what="motion")

    def wait_for_end(self, text):
        """Wait until the newest goal ends as ``text``."""
        newest = self.newest_goal()

        def has_ended():
            results = self.results[-1].status if self.results else []
            return any(one.name == newest and one.message == text for one in results)

        self.peer.spin_until(has_ended, what=f"the end {text!r}")


def drive_to_all_ends(session, action_peer):
    """Drive to goals that end in all ways, sent by topics and by an action."""
    session.send(A)
    session.wait_for_motion()
    session.send(B)
    session.wait_for_end("reached")
    session.send(B)  # another goal at the pose where the robot is
    session.wait_for_end("reached")
    session.send(FAR)
    session.wait_for_motion()
    session.driven.cancel()
    session.send(*PATH)
    session.wait_for_end("reached")
    to_pose = action_peer(session.peer, "navigate_to_pose")
    replaced = to_pose.send(pose=pose_stamped(*A))
    session.wait_for_motion()
    reached = to_pose.send(pose=pose_stamped(*B))
    to_pose.result(replaced)
    to_pose.result(reached)
    assert session.driven.set_parameter("controller", "goal_timeout", 4.0).successful
    session.send(FAR)
    session.wait_for_end("not reached")
    assert session.driven.set_parameter("controller", "goal_timeout", -1.0).successful
    session.send(FAR)  # not reached before the live page is read
    session.wait_for_motion()


@pytest.fixture(scope="module")
def recorded(tmp_path_factory, nav2_folder, action_peer):
    """Return the bag of a drive, and the events of the live page that was open from its begin on."""
    folder = tmp_path_factory.mktemp("goals") / "bag"
    environment = graph.environment()
    environment["PYTHONPATH"] += f":{nav2_folder}"
    with (
        on_truth(PLANT, SIMULATED, env=environment) as driven,
        graph.diffbot("watch", "--port", "0") as watch,
        graph.node("diffbot_bag.recorder_node", {"uri": str(folder), **SIMULATED}) as recorder,
    ):
        session = Session(driven)
        watch.wait_for_output("Page: ")
        session.wait_for_recorder()
        client = watch_page.Client(watch_page.url_of(watch))
        client.wait_for(lambda: client.state[2] == "idle", "the robot on the live page")
        client.close()
        drive_to_all_ends(session, action_peer)
        assert recorder.stop() == 0
        client = watch_page.Client(watch_page.url_of(watch))
        client.wait_for(lambda: client.events, "the events of the live page")
        client.close()
    return folder, client.events


def events_of(bag):
    """Return kind and text of the report's events of goals."""
    (robot,) = page_data(read_bag(bag))["robots"]
    return [(kind, text) for _, kind, _, text in robot["events"] if kind in ("goal", "end")]


def test_each_goal_of_a_report_has_its_own_end_and_time(recorded):
    bag, _ = recorded
    (robot,) = page_data(read_bag(bag))["robots"]
    rows = robot["cards"]
    verdicts = [re.sub(r" \((sent by|after) .*| (after|in) [0-9.]+ s.*", "", row["verdict"]) for row in rows]
    assert verdicts == [
        *("Replaced: by a newer goal (goal_pose)", "Reached", "Reached"),
        *("Cancelled: by a call of /controller/cancel from /peer or /watch_client", "Passed", "Reached"),
        *("Replaced: by a newer goal (action)", "Reached", "Not reached within goal_timeout = 4 s"),
        "No answer: the recording ends before",
    ]
    outcomes = read_bag(bag).robots[0].outcomes
    goals = [A, B, B, FAR, *PATH, A, B, FAR, FAR]
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
