"""The controller with laws of others: they reach goals, and one that fails leaves the robot standing with a reason."""

import itertools
import math
from functools import partial
from typing import Annotated, NamedTuple

import graph
import numpy as np
import one_process
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from filter_input import fix
from geometry_msgs.msg import Twist as TwistMessage
from robot import LATCHED, distance, lockstep, pose_stamped, turned, twist

from diffbot_control.controller_node import ControllerNode
from diffbot_control.law import Report
from diffbot_core.data_sheet import DataSheet
from diffbot_core.kinematics import Twist
from diffbot_core.schema import Spec

ACCELERATION = 0.5


class Config(NamedTuple):
    raises: Annotated[bool, Spec("it raises instead of answering nan")] = False
    data_sheet: DataSheet = DataSheet()


class Memory(NamedTuple):
    reached: bool


class Failing:
    """Drives straight ahead, and fails within 2 m of the goal."""

    name, Config = "failing", Config

    @staticmethod
    def new_memory(_config):
        return Memory(False)

    @staticmethod
    def step(_memory, estimate, goal, _dt, config):
        rho, v = math.hypot(goal.x - estimate.pose.x, goal.y - estimate.pose.y), 0.5
        if rho < 2.0:
            v = 1.0 / 0.0 if config.raises else math.nan
        return Memory(False), Twist(v, 0.0), Report(rho, 0.0, 0.0, 0.0, 0.0, 0, 0.0)


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


@pytest.mark.parametrize(
    ("raises", "reason"),
    [(False, "v = nan m/s, omega = 0.0 rad/s: must be finite"), (True, "ZeroDivisionError: float division by zero ")],
)
def test_a_law_that_fails_stops_the_robot_within_the_limits_and_the_next_goal_is_driven_to(raises, reason):
    with one_process.nodes() as nodes:
        limits = {"linear.x.max_acceleration": ACCELERATION, "pose_timeout": 60.0}
        fed = one_process.Fed(nodes, ControllerNode, {"law": f"{__name__}:Failing", "raises": raises, **limits})
        commands = nodes.peer.subscribe(TwistMessage, "cmd_vel", 1000)
        states = nodes.peer.subscribe(DiagnosticStatus, "controller/status", LATCHED)
        times = itertools.count(1000.0, 0.1)

        def stands(goal, places):
            fed.send("pose", fix(next(times), next(places, goal - 1.0), 0.0, 0.0))
            has_failed = states and states[-1].message == "goal not reached"
            return has_failed and twist(commands[-1]) == (0.0, 0.0)

        for goal in (5.0, 8.0):
            fed.send("goal_pose", pose_stamped(goal, 0.0, 0.0))
            places = iter(np.arange(goal - 3.0, goal - 1.0, 0.05))
            nodes.peer.spin_until(partial(stands, goal, places), what="rest")
            assert graph.values(states[-1])["reason"].startswith(f"law failing failed: {reason}")
            speeds = [twist(command)[0] for command in commands]
            assert 0.0 < max(speeds) <= 0.5
            assert min(np.diff(speeds)) >= -ACCELERATION * 0.1 - 1e-9
            commands.clear()
            states.clear()
