"""The controller with laws of others: they reach goals, and one that fails leaves the robot standing with a reason."""

import graph
from robot import distance, lockstep, turned


def test_a_law_of_others_reaches_a_goal():
    goal = (-1.0, -4.0, 2.0)
    with lockstep(controller={"law": "rotate_drive_rotate"}, only=("robot", "plant"), joined=True) as robot:
        robot.send_goal(*goal)
        robot.pause(False)
        robot.wait_for_state("goal reached")
        robot.pause(True)
        assert distance(robot.true_pose(), goal) <= 0.2
        assert turned(robot.true_pose(), goal) <= 0.15
        status = graph.values(robot.controller_states[-1])
        assert (status["law"], status["goals reached"]) == ("rotate_drive_rotate", "1")
        # Of this project's law alone.
        assert not {"region", "switches", "eps_P [m]", "finish", "smallest tolerance [m]"} & set(status)
