"""A controller that is killed while it drives: the robot stops, and its clients send the lost goal again."""

import signal
from contextlib import closing

import graph
from robot import ON_TRUTH, TRUE_POSES, distance, robot

from diffbot_control.ros.goals.client import LOST, GoalClient, Task
from diffbot_core.geometry import Pose

START, GOAL = Pose(-4.0, 0.2, 0.0), Pose(1.0, 0.2, 0.0)
PLANT = {"initial_pose.x": START.x, "initial_pose.y": START.y, "initial_pose.yaw": START.theta}


def test_a_goal_of_a_killed_controller_is_lost_for_its_clients_and_can_be_sent_again():
    with (
        closing(GoalClient.in_own_context()) as waiting,
        closing(GoalClient.in_own_context(node_name="patient", restart_timeout=graph.PATIENCE)) as patient,
        robot(PLANT, only=("plant",)) as bare,
    ):
        bare.launch("controller", ON_TRUTH, TRUE_POSES)
        bare.wait_until_ready("controller")
        lost = waiting.send_goal([GOAL])
        patient.task = Task(lost.id)
        bare.peer.spin_until(lambda: bare.truths and bare.truths[-1].twist.twist.linear.x > 0.1, what="a driving robot")
        bare.processes["controller"].stop(signal.SIGKILL)
        assert waiting.wait_for_end(graph.PATIENCE)
        assert (lost.end, lost.reason) == (LOST, "the controller is gone")
        bare.catch_up()  # and take the last statuses of the killed controller before the list is cleared
        bare.peer.spin_until(lambda: bare.truths[-1].twist.twist.linear.x == 0.0, what="standstill")
        assert not patient.task.end
        bare.controller_states.clear()
        bare.launch("controller", ON_TRUTH, TRUE_POSES)
        bare.wait_until_ready("controller")
        assert patient.wait_for_end(graph.PATIENCE)
        assert (patient.task.end, patient.task.reason) == (LOST, "the controller was restarted")
        bare.wait_for_state("idle")
        again = waiting.send_goal([GOAL])
        assert waiting.wait_for_end(graph.PATIENCE)
        assert (again.end, again.reason) == ("reached", "")
        assert distance(bare.true_pose(), GOAL) < 0.4
