"""What becomes of a goal when the controller is killed: it is resumed, and each client has its answer."""

import signal
from contextlib import closing

import graph
from robot import ON_TRUTH, TRUE_POSES, distance, robot

from diffbot_control.ros.goals.client import LOST, GoalClient, Task
from diffbot_core.geometry import Pose

START = Pose(-4.0, 0.2, 0.0)
PLANT = {"initial_pose.x": START.x, "initial_pose.y": START.y, "initial_pose.yaw": START.theta}
RESTARTED = "the controller was restarted"


def test_a_path_is_resumed_where_it_was_left_and_its_clients_learn_what_became_of_it(tmp_path):
    file, path = tmp_path / "goal.json", [Pose(-3.2, 0.2, 0.0), Pose(1.0, 0.2, 0.0)]
    parameters = {**ON_TRUTH, "goal_file": file, "resume_goal": True, "resume_timeout": 10.0 * graph.PATIENCE}
    parameters["waypoint_radius"] = 0.3
    with (
        closing(GoalClient.in_own_context()) as waiting,
        closing(GoalClient.in_own_context(node_name="ahead", restart_timeout=graph.PATIENCE)) as ahead,
        robot(PLANT, only=("plant",)) as bare,
    ):
        bare.launch("controller", parameters, TRUE_POSES)
        bare.wait_until_ready("controller")
        given_up = waiting.send_goal(path)
        ahead.task = task = Task(given_up.id)
        bare.peer.spin_until(lambda: '"waypoint": 2' in file.read_text(), what="the first waypoint in the file")
        bare.processes["controller"].stop(signal.SIGKILL)
        assert task.id in file.read_text()
        assert waiting.wait_for_end(graph.PATIENCE)
        assert (given_up.end, given_up.reason) == (LOST, "the controller is gone")
        bare.catch_up()  # and take the last statuses of the killed controller before the list is cleared
        bare.peer.spin_until(lambda: bare.truths and bare.truths[-1].twist.twist.linear.x == 0.0, what="standstill")
        bare.controller_states.clear()
        bare.launch("controller", parameters, TRUE_POSES)
        bare.wait_until_ready("controller")
        assert f"{RESTARTED}: goal {task.id} is driven to again" in bare.processes["controller"].output
        bare.peer.spin_until(lambda: bare.controller_states, what="a status")
        assert graph.values(bare.controller_states[0])["waypoint"] == "2/2"
        assert ahead.wait_for_end(graph.PATIENCE)
        assert (task.end, task.reason) == ("reached", "")
        assert distance(bare.true_pose(), path[-1]) < 0.4
        graph.wait_for(lambda: not file.exists(), what="the end of the file")
