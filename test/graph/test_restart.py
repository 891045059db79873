"""What becomes of a goal when the controller is killed: resumed or given up, and its client has an answer."""

import signal

import graph
import pytest
from robot import ON_TRUTH, TRUE_POSES, distance, robot, twist

from diffbot_control.ros.goals.client import LOST, GoalClient, Task
from diffbot_core.geometry import Pose

START = Pose(-4.0, 0.2, 0.0)
PLANT = {"initial_pose.x": START.x, "initial_pose.y": START.y, "initial_pose.yaw": START.theta}
RESTARTED = "the controller was restarted"


@pytest.fixture(scope="module")
def bare():
    """Have a robot without a controller."""
    with robot(PLANT, only=("plant",)) as running:
        yield running


@pytest.fixture
def start(bare, tmp_path):
    """Return a function that starts a controller with a file for its goal."""

    def begin(**parameters):
        bare.controller_states.clear()
        bare.commands.clear()
        bare.launch("controller", {**ON_TRUTH, "goal_file": tmp_path / "goal.json", **parameters}, TRUE_POSES)
        bare.wait_until_ready("controller")

    yield begin
    bare.processes["controller"].stop()


def kill(robot):
    robot.processes["controller"].send(signal.SIGKILL)
    robot.processes["controller"].wait()


def test_a_path_is_resumed_where_it_was_left_and_its_client_learns_its_end(bare, start, tmp_path):
    file, resuming = tmp_path / "goal.json", {"resume_goal": True, "waypoint_radius": 0.3}
    start(**resuming)
    ahead = GoalClient.in_own_context(restart_timeout=graph.PATIENCE)
    try:
        path = [Pose(-3.2, 0.2, 0.0), Pose(-2.0, 0.2, 0.0)]
        task = ahead.send_goal(path)
        bare.peer.spin_until(lambda: '"waypoint": 2' in file.read_text(), what="the first waypoint in the file")
        kill(bare)
        assert task.id in file.read_text()
        start(**resuming)
        assert f"{RESTARTED}: goal {task.id} is driven to again" in bare.processes["controller"].output
        bare.peer.spin_until(lambda: bare.controller_states, what="a status")
        assert graph.values(bare.controller_states[0])["waypoint"] == "2/2"
        assert ahead.wait_for_end(graph.PATIENCE)
        assert (task.end, task.reason) == ("reached", "")
        assert distance(bare.true_pose(), path[-1]) < 0.4
        graph.wait_for(lambda: not file.exists(), what="the end of the file")
    finally:
        ahead.close()


def test_by_default_a_goal_is_given_up_with_an_answer_and_the_robot_stands(bare, start, tmp_path):
    start()
    waiting = GoalClient.in_own_context()
    later = GoalClient.in_own_context(node_name="later", restart_timeout=graph.PATIENCE)
    try:
        task = waiting.send_goal([Pose(3.0, 0.2, 0.0)])
        bare.peer.spin_until(lambda: bare.commands and abs(twist(bare.commands[-1])[0]) > 0.3, what="motion")
        kill(bare)
        assert waiting.wait_for_end(graph.PATIENCE)
        assert (task.end, task.reason) == (LOST, "the controller is gone")
        bare.peer.spin_until(lambda: bare.truths[-1].twist.twist.linear.x == 0.0, what="standstill")
        place = bare.true_pose()
        start()
        bare.wait_for_state("goal not reached")
        assert graph.values(bare.controller_states[-1])["reason"] == RESTARTED
        later.task = Task(task.id)
        assert later.wait_for_end(graph.PATIENCE)
        assert (later.task.end, later.task.reason) == ("not reached", RESTARTED)
        assert {twist(command) for command in bare.commands} <= {(0.0, 0.0)}
        assert bare.true_pose() == place
        assert not (tmp_path / "goal.json").exists()
    finally:
        waiting.close()
        later.close()
