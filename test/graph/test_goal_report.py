"""Ends of goals in recordings of a real robot: the report matches each end to its goal, and the live page agrees."""

import re
from collections import Counter
from types import SimpleNamespace

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
A, B, C, D, E = (1.0, -4.0, 0.0), (-4.0, -3.0, 1.0), (-1.0, -4.5, 0.5), (-2.5, -5.0, 0.0), (0.0, -5.0, 1.0)
PATH = (-1.5, -4.5, 0.0), (0.5, -3.5, 0.5)


class Session:
    """A robot, and what its controller says of goals."""

    def __init__(self, driven):
        self.driven = driven
        subscribe = driven.peer.subscribe
        self.states = subscribe(GoalStatusArray, "controller/goal_status", LATCHED)
        self.results = subscribe(DiagnosticArray, "controller/goal_results", LATCHED)
        self.reports = subscribe(DiagnosticStatus, "/recorder/status", LATCHED)
        self.paths = driven.peer.publisher(Path, "path")
        self.statuses = subscribe(DiagnosticStatus, "controller/status", DEEP)

    @property
    def peer(self):
        return self.driven.peer

    def wait_for_recorder(self, folder):
        """Wait until a recorder receives all that a report needs."""
        wanted = {"/goal_pose", "/ground_truth", "/controller/status", "/controller/goal_results"}

        def receives():
            reports = [graph.values(one) for one in self.reports]
            return any(one["uri"] == str(folder) and wanted <= set(one["topics"].split()) for one in reports)

        self.peer.spin_until(receives, what=f"the recorder of {folder.name}")
        # What is published from now on, it receives.
        before = len(self.statuses)
        self.peer.spin_until(lambda: len(self.statuses) > before + 1, what="two statuses")

    def publish(self, goal):
        """Send a goal by its topic and wait until the controller has accepted it."""
        before = self.accepted()
        self.peer.wait_for_subscribers(self.driven.goals)
        self.driven.goals.publish(pose_stamped(*goal))
        self.peer.spin_until(lambda: self.accepted() != before, what="a new goal")

    def accepted(self):
        """Id of the goal that is under way, by controller/goal_status."""
        states = self.states[-1].status_list if self.states else []
        return bytes(states[-1].goal_info.goal_id.uuid).hex() if states else ""

    def send(self, *goals):
        """Send a goal or a path with a stamp, and wait as in :meth:`publish`; sent twice, it is one goal."""
        goal_id, message = stamped_goal(*goals)
        publisher = self.driven.goals if len(goals) == 1 else self.paths
        self.peer.wait_for_subscribers(publisher)
        publisher.publish(message)
        publisher.publish(message)
        self.peer.spin_until(lambda: self.accepted() == goal_id, what="the goal")

    def drive(self, way=0.1):
        """Wait until the robot has driven so far [m], as the crow flies."""
        before = self.driven.true_pose()
        self.peer.spin_until(lambda: distance(before, self.driven.true_pose()) > way, what="motion")

    def end(self, text):
        """Wait until the newest goal ends as ``text``."""
        newest = self.accepted()

        def ended():
            results = self.results[-1].status if self.results else []
            return any(one.name == newest and one.message == text for one in results)

        self.peer.spin_until(ended, what=f"the end {text!r}")


def recorder(folder):
    return graph.node("diffbot_bag.recorder_node", {"uri": str(folder), **SIMULATED})


def drive_to_all_ends(session, action_peer):
    """Drive to goals from the topics, the command and the action, one after the other."""
    driven = session.driven
    for goal in (A, B, C):  # replaced twice
        session.publish(goal)
        session.drive()
    session.end("reached")
    session.publish(D)
    session.drive()
    session.publish(D)  # the same goal again
    session.end("reached")
    session.publish(D)  # the robot is there already
    session.end("reached")
    session.send(FAR)
    session.drive()
    driven.cancel()
    session.send(C)
    session.end("reached")
    with graph.diffbot("goal", *map(str, E)) as command:
        assert command.wait() == 0
    session.send(*PATH)
    session.end("reached")
    to_pose = action_peer(driven.peer, "navigate_to_pose")
    replaced = to_pose.send(pose=pose_stamped(*A))
    session.drive()
    reached = to_pose.send(pose=pose_stamped(*B))
    to_pose.result(replaced)
    to_pose.result(reached)
    assert driven.set_parameter("controller", "goal_timeout", 4.0).successful
    session.send(FAR)
    session.end("not reached")
    assert driven.set_parameter("controller", "goal_timeout", -1.0).successful


def record_late(session, folder):
    """Record one bag from within a goal on, and one from a goal that is held."""
    session.publish(A)
    session.drive(2.0)
    assert session.driven.pause(True).success
    with recorder(folder / "within") as within:
        session.wait_for_recorder(folder / "within")
        assert session.driven.pause(False).success
        session.end("reached")
        with recorder(folder / "held") as held:
            session.wait_for_recorder(folder / "held")
            session.publish(C)
            session.end("reached")
            session.publish(FAR)
            session.drive()
            assert held.stop() == 0
        assert within.stop() == 0


@pytest.fixture(scope="module")
def recorded(tmp_path_factory, nav2_folder, action_peer):
    """Drive all kinds of goals; return three bags, from the start, from within a goal, and from a held goal on."""
    folder = tmp_path_factory.mktemp("goals")
    environment = graph.environment()
    environment["PYTHONPATH"] += f":{nav2_folder}"
    with (
        on_truth(PLANT, SIMULATED, env=environment) as driven,
        graph.diffbot("watch", "--port", "0") as watch,
        recorder(folder / "whole") as whole,
    ):
        session = Session(driven)
        watch.wait_for_output("Page: ")
        session.wait_for_recorder(folder / "whole")
        client = watch_page.Client(watch_page.url_of(watch))
        client.wait_for(lambda: client.state[2] == "idle", "the robot on the live page")
        client.close()
        drive_to_all_ends(session, action_peer)
        record_late(session, folder)
        assert whole.stop() == 0
        client = watch_page.Client(watch_page.url_of(watch))
        client.wait_for(lambda: client.events, "the events of the live page")
        client.close()
        yield SimpleNamespace(folder=folder, live=client.events)


def summary(folder):
    """Return the rows of the report, and its events of goals."""
    (one,) = page_data(read_bag(folder))["robots"]
    return one["cards"], [(kind, text) for _, kind, _, text in one["events"] if kind in ("goal", "end")]


def results_of(folder):
    """Return id, end and elapsed time [s] of each goal that ended, as rosbags reads them."""
    found = {}
    for _, message in bag_makers.read(folder)["/controller/goal_results"]:
        for one in message.status:
            values = {pair.key: pair.value for pair in one.values}
            found[one.name] = one.message, float(values["elapsed time [s]"])
    return list(found.values())


def verdicts(rows):
    return [re.sub(r" \((sent by|after) .*| (after|in) [0-9.]+ s.*", "", row["verdict"]) for row in rows]


def seconds(row):
    return float(re.search(r"([0-9.]+) s\)?$", row["verdict"])[1])


def test_each_end_is_that_of_its_own_goal(recorded):
    rows, events = summary(recorded.folder / "whole")
    late = "Not reached within goal_timeout = 4 s"
    assert verdicts(rows) == [
        *("Replaced: by a newer goal (goal_pose)", "Replaced: by a newer goal (goal_pose)", "Reached"),
        *("Replaced: by a newer goal (goal_pose)", "Reached", "Reached"),
        *("Cancelled: by a call of /controller/cancel from /peer or /watch_client", "Reached", "Reached"),
        *("Passed", "Reached"),
        *("Replaced: by a newer goal (action)", "Reached", late),
        *("Reached", "Reached", "No answer: the recording ends before"),
    ]
    goals = [A, B, C, D, D, D, FAR, C, E, *PATH, A, B, FAR, A, C, FAR]
    outcomes = read_bag(recorded.folder / "whole").robots[0].outcomes
    assert [one.goal for one in outcomes] == [pytest.approx(goal, abs=1e-4) for goal in goals]
    # The path has one end, which is that of its last pose.
    ended = [row for row in rows if row["end"] and row["end"] != "passed"]
    for row, (end, elapsed) in zip(ended, results_of(recorded.folder / "whole"), strict=True):
        assert row["end"].startswith(end)
        # On a busy machine the recorder is late.
        assert elapsed - 0.06 <= seconds(row) <= elapsed + 2.0
    ends = [re.sub(r"^goal |:? [\[(].*|: .*", "", text) for kind, text in events if kind == "end"]
    assert ends == [row["end"] for row in ended]


def test_the_live_page_lists_the_same_goals_and_ends(recorded):
    _, events = summary(recorded.folder / "whole")
    for kind in ("goal", "end"):
        # Of messages at one time, either list may have any first.
        live = [text for _, one, _, text in recorded.live if one == kind]
        assert live == [text for one, text in events if one == kind]


def test_a_bag_that_begins_within_a_goal_has_its_end_and_its_whole_time(recorded):
    rows, _ = summary(recorded.folder / "within")
    assert verdicts(rows) == ["Reached", "Reached", "No answer: the recording ends before"]
    whole = summary(recorded.folder / "whole")[0][-3:]
    for row, of_whole in zip(rows[:2], whole[:2], strict=True):
        assert seconds(row) == pytest.approx(seconds(of_whole), abs=0.5)
    assert rows[0]["ended"] - rows[0]["time"] < seconds(rows[0]) - 0.5, "it had begun before"


def test_the_held_goal_before_a_bag_is_none_of_its_goals(recorded):
    rows, events = summary(recorded.folder / "held")
    assert verdicts(rows) == ["Reached", "No answer: the recording ends before"]
    assert Counter(kind for kind, _ in events) == {"goal": 2, "end": 1}
