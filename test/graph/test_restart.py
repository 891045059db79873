"""What becomes of a goal when the controller is killed: resumed or given up, and its client has an answer."""

import signal
import time

import graph
import pytest
from robot import distance, robot, twist

from diffbot_control.ros.controller_watch import SILENCE
from diffbot_control.ros.goal_client import LOST, GoalClient, Task
from diffbot_core.geometry import Pose

START = Pose(-4.0, 0.2, 0.0)
PLANT = {"initial_pose.x": START.x, "initial_pose.y": START.y, "initial_pose.yaw": START.theta}


@pytest.fixture(scope="module")
def bare():
    """Have a robot without a controller."""
    with robot(PLANT, only=("ekf", "plant")) as running:
        yield running


@pytest.fixture
def goal_file(tmp_path):
    return tmp_path / "goal.json"


def client(**options):
    return GoalClient.in_own_context(**options)


def is_driving(robot):
    return robot.commands and abs(twist(robot.commands[-1])[0]) > 0.3


def kill(robot):
    robot.processes["controller"].send(signal.SIGKILL)
    robot.processes["controller"].wait()
    return time.monotonic()


def start(robot, goal_file, **parameters):
    robot.controller_states.clear()
    robot.start("controller", {"goal_file": goal_file, **parameters})


def test_a_path_is_resumed_where_it_was_left_and_its_client_learns_its_end(bare, goal_file):
    start(bare, goal_file, resume_goal=True, waypoint_radius=0.3)
    ahead = client(restart_timeout=30.0)
    try:
        path = [Pose(-3.2, 0.2, 0.0), Pose(-2.0, 0.2, 0.0)]
        task = ahead.send_goal(path)
        bare.peer.spin_until(lambda: '"waypoint": 2' in goal_file.read_text(), 20.0, "the first waypoint in the file")
        kill(bare)
        assert task.id in goal_file.read_text()
        start(bare, goal_file, resume_goal=True, waypoint_radius=0.3)
        assert f"the controller was restarted: goal {task.id} is driven to again" in bare.processes["controller"].output
        bare.peer.spin_until(lambda: bare.controller_states, 5.0, "a status")
        assert graph.values(bare.controller_states[0])["waypoint"] == "2/2"
        assert ahead.wait_for_end(40.0)
        assert (task.end, task.reason) == ("reached", "")
        assert distance(bare.true_pose(), path[-1]) < 0.4
        graph.wait_for(lambda: not goal_file.exists(), 2.0, "the end of the file")
    finally:
        ahead.close()
        bare.processes["controller"].stop()


def test_by_default_a_goal_is_given_up_with_an_answer_and_the_robot_stands(bare, goal_file):
    start(bare, goal_file)
    waiting, later = client(), client(node_name="later", restart_timeout=20.0)
    try:
        bare.commands.clear()
        task = waiting.send_goal([Pose(3.0, 0.2, 0.0)])
        bare.peer.spin_until(lambda: is_driving(bare), 10.0, "motion")
        killed = kill(bare)
        assert waiting.wait_for_end(SILENCE)
        assert (task.end, task.reason) == (LOST, "the controller is gone")
        print(f"known to be gone after {time.monotonic() - killed:.2f} s")
        assert 1.0 < time.monotonic() - killed < 20.0
        bare.peer.spin_until(lambda: bare.truths[-1].twist.twist.linear.x == 0.0, 5.0, "standstill")
        place = bare.true_pose()
        bare.commands.clear()
        start(bare, goal_file)
        bare.wait_for_state("goal not reached", 5.0)
        assert graph.values(bare.controller_states[-1])["reason"] == "the controller was restarted"
        later.task = Task(task.id)
        assert later.wait_for_end(10.0)
        assert (later.task.end, later.task.reason) == ("not reached", "the controller was restarted")
        assert {twist(command) for command in bare.commands} <= {(0.0, 0.0)}
        assert bare.true_pose() == place
        assert not goal_file.exists()
    finally:
        waiting.close()
        later.close()
        bare.processes["controller"].stop()
