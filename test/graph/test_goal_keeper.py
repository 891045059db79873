"""The file of the present goal, while a controller runs and when it starts again, in one process."""

import os
import time

import pytest
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Twist
from rosgraph_msgs.msg import Clock

from diffbot_control.controller_node import ControllerNode
from diffbot_control.goals.states import DRIVING
from diffbot_control.ros.goals.goal_file import SavedGoal, load_goal, save_goal
from diffbot_core.geometry import Pose
from diffbot_core.uncertainty import CERTAIN

ID = "0123456789abcdef" * 2
SINGLE = SavedGoal(ID, "request", "map", [Pose(1.0, 2.0, 0.5)])
PATH = SavedGoal(ID, "path", "map", [Pose(1.0, 2.0, 0.5), Pose(3.0, 2.0, 0.0)], 4, 5)
RESTARTED = "the controller was restarted"


@pytest.fixture
def start(nodes, tmp_path):
    """Return a function that starts a controller with the file; the one before it is destroyed."""
    running = []

    def start(**parameters):
        while running:
            nodes.remove(running.pop())
        running.append(nodes.add(ControllerNode, {"goal_file": str(tmp_path / "goal"), **parameters}))
        return running[-1]

    return start


def ends(node):
    return [(record.request.id, record.end, record.reason) for record in node.supervisor.goals.ended]


@pytest.mark.parametrize("goal", [SINGLE, PATH])
def test_a_goal_is_given_up_by_default_and_resumed_where_that_is_asked_for(goal, start, tmp_path):
    path = tmp_path / "goal"
    save_goal(path, goal)
    node = start()
    assert ends(node) == [(ID, "not reached", RESTARTED)]
    assert node.supervisor.goal is None
    assert not path.exists()
    save_goal(path, goal)
    node = start(resume_goal=True)
    present = node.supervisor.goals.present
    assert (present.request.id, present.request.source) == (ID, goal.source)
    assert node.supervisor.goals_ahead == goal.poses
    assert (node.supervisor.waypoint, node.supervisor.waypoints) == (goal.waypoint, goal.waypoints)
    # It is still known after another death.
    assert load_goal(path, 10) == goal


def test_a_corrected_goal_is_resumed_as_it_was_corrected(start, tmp_path):
    path = tmp_path / "goal"
    save_goal(path, PATH)
    node = start(resume_goal=True)
    node.supervisor.on_goal_update(Pose(3.2, 2.1, 0.1))
    deadline = time.monotonic() + 10.0
    while (found := load_goal(path, 10)) == PATH and time.monotonic() < deadline:
        node._keeper.save()
    assert found == PATH._replace(poses=[Pose(1.0, 2.0, 0.5), Pose(3.2, 2.1, 0.1)])


@pytest.mark.parametrize(
    ("goal", "end"),
    [
        (SINGLE._replace(poses=[], is_cancelling=True), ("cancelled", "")),
        (SINGLE._replace(frame="floor_2"), ("not reached", f"{RESTARTED}, with another map_frame than floor_2")),
    ],
)
def test_a_goal_that_was_being_cancelled_or_is_in_another_frame_is_not_resumed(goal, end, start, tmp_path):
    save_goal(tmp_path / "goal", goal)
    assert ends(start(resume_goal=True)) == [(ID, *end)]


def test_a_goal_of_long_ago_is_given_up_and_one_of_the_future_too(start, tmp_path):
    path = tmp_path / "goal"
    for age in (1000.0, -1000.0):
        save_goal(path, SINGLE)
        os.utime(path, (0.0, time.time() - age))
        ((_, end, reason),) = ends(start(resume_goal=True, resume_timeout=600.0))
        assert end == "not reached"
        assert reason.startswith(f"{RESTARTED}, and was last alive {'-' if age < 0 else ''}")
    save_goal(path, SINGLE)
    os.utime(path, (0.0, time.time() - 100.0))
    assert ends(start(resume_goal=True, resume_timeout=600.0)) == []


def test_the_first_clock_is_no_silence_for_a_resumed_goal_and_for_poses_that_came_before_it(nodes, start, tmp_path):
    save_goal(tmp_path / "goal", SINGLE)
    node = start(resume_goal=True, use_sim_time=True, publish_when_idle=True)
    assert node.supervisor.goals.present.request.time == 0.0
    last, place = 5000 * 10**9, Pose(-3.0, 2.0, 0.5)
    node.take_pose(last - 10**8, place, CERTAIN)
    node.take_pose(last, place, CERTAIN)
    clocks = nodes.peer.publisher(Clock, "/clock")
    commands = nodes.peer.subscribe(Twist, "cmd_vel")
    nodes.peer.wait_for_publishers("cmd_vel")
    nodes.peer.wait_for_subscribers(clocks)
    clocks.publish(Clock(clock=Time(sec=5000)))
    nodes.peer.spin_until(lambda: node.supervisor.goals.present.request.time == 5000.0, what="the time of the goal")
    # Sent again, as in lock-step after a second: it is answered as before, and not with zero.
    node.take_pose(last, place, CERTAIN)
    nodes.peer.spin_until(lambda: commands, what="the answer")
    assert commands[0].linear.x > 0.0
    assert node.supervisor.status == DRIVING


def test_the_file_follows_the_goal(start, tmp_path, monkeypatch):
    path, now = tmp_path / "goal", [1000.0]
    monkeypatch.setattr("diffbot_control.ros.goals.keeper.time.monotonic", lambda: now[0])
    node = start()
    assert not path.exists()
    node.goals.accept_goals(SINGLE.poses, False, "request", ID)
    assert load_goal(path, 10) == SINGLE
    # The next one comes too soon for another write, but the former one has ended.
    node.goals.accept_goals(PATH.poses, True, "path", ID[::-1])
    assert not path.exists()
    now[0] += 0.2
    node._publish_status()
    assert load_goal(path, 10) == PATH._replace(id=ID[::-1], waypoint=1, waypoints=2)
    os.utime(path, (0.0, 0.0))
    node._publish_status()
    assert path.stat().st_mtime > 1e9, "the controller is alive"
    path.unlink()
    node._publish_status()
    now[0] += 0.2
    node._publish_status()
    assert load_goal(path, 10).id == ID[::-1], "deleted by another program, written again"
    node.cancel()
    assert not path.exists()


def test_a_file_that_is_none_is_kept_aside_and_a_folder_that_refuses_it_is_reported(start, tmp_path, capfd):
    (tmp_path / "goal").write_text("my only copy of something else")
    assert ends(start(resume_goal=True)) == []
    assert (tmp_path / "goal.bad").read_text() == "my only copy of something else"
    assert "goal is no JSON; the file is kept as goal.bad" in capfd.readouterr().err
    (tmp_path / "file").touch()
    node = start(goal_file=str(tmp_path / "file" / "goal"))
    node.goals.accept_goals(SINGLE.poses, False, "request", ID)
    assert node.supervisor.goal == SINGLE.poses[0]
    assert "cannot write goal_file: " in capfd.readouterr().err
