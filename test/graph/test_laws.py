"""The controller with laws of others: they reach goals, and one that fails leaves the robot standing with a reason."""

import contextlib
import os
from pathlib import Path

import graph
import numpy as np
import pytest
from graph import values
from robot import SIMULATED, distance, lockstep, turned, twist

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
LAWS_OF_THE_TEST = """
import math
from typing import Annotated, NamedTuple
from diffbot_control.law import Report
from diffbot_core.data_sheet import DataSheet
from diffbot_core.kinematics import Twist
from diffbot_core.schema import Spec

class Config(NamedTuple):
    speed: Annotated[float, Spec("speed of the drive", "m/s", 0.1, 1.0)] = 0.5
    within: Annotated[float, Spec("the law fails below this distance", "m", 0.0, 10.0)] = 2.0
    raises: Annotated[bool, Spec("it raises instead of answering nan")] = False
    data_sheet: DataSheet = DataSheet()

class Memory(NamedTuple):
    reached: bool

class Failing:
    name, Config = "failing", Config

    @staticmethod
    def new_memory(config):
        return Memory(False)

    @staticmethod
    def step(memory, estimate, goal, dt, config):
        rho, v = math.hypot(goal.x - estimate.pose.x, goal.y - estimate.pose.y), config.speed
        if rho < config.within:
            v = 1.0 / 0.0 if config.raises else math.nan
        return Memory(False), Twist(v, 0.0), Report(rho, 0.0, 0.0, 0.0, 0.0, 0, 0.0)
"""
ACCELERATION = 0.5
SETTLED = 10
"""poses after the end of a drive before the true pose counts"""


@contextlib.contextmanager
def driven_by(law, folder=EXAMPLES, plant=None, **parameters):
    """Run a robot in lock-step whose controller finds laws in ``folder``; it stands until it is let go."""
    path = os.pathsep.join((str(graph.SOURCE), str(folder)))
    with lockstep(plant, only=("ekf", "plant")) as robot:
        given = {"publish_when_idle": True, "reliable_inputs": True, **SIMULATED, "law": law, **parameters}
        robot.launch("controller", given, env=graph.environment(PYTHONPATH=path))
        robot.wait_until_ready("controller")
        yield robot


def drive(robot, goal):
    """Drive to a goal and stand there a while; return the true pose, with the plant paused."""
    robot.send_goal(*goal)
    robot.pause(False)
    robot.peer.spin_until(lambda: robot.state() in ("goal reached", "goal not reached"), what=f"an end at {goal}")
    count = len(robot.truths)
    robot.peer.spin_until(lambda: len(robot.truths) > count + SETTLED, what="a while at the goal")
    if robot.state() == "goal not reached":
        robot.peer.spin_until(lambda: twist(robot.commands[-1]) == (0.0, 0.0), what="the command to stand")
    robot.pause(True)
    return robot.true_pose()


def test_a_law_of_others_reaches_goals():
    with driven_by("straight_line:StraightLine") as robot:
        for reached, goal in enumerate([(0.0, 0.0, 0.0), (-1.0, 1.5, 2.0)], 1):
            end = drive(robot, goal)
            assert distance(end, goal) <= 0.2
            assert turned(end, goal) <= 0.15
            status = values(robot.controller_states[-1])
            assert (status["law"], status["goals reached"]) == ("straight_line", str(reached))
            # Of this project's law alone.
            assert not {"region", "switches", "eps_P [m]", "finish", "smallest tolerance [m]"} & set(status)


def test_a_law_that_fails_stops_the_robot_and_the_next_goal_is_driven_to(tmp_path):
    (tmp_path / "laws_of_the_test.py").write_text(LAWS_OF_THE_TEST)
    failures = [
        (2.0, False, "law failing failed: v = nan m/s, omega = 0.0 rad/s: must be finite"),
        (1.0, True, "law failing failed: ZeroDivisionError: float division by zero (laws_of_the_test.py:29)"),
    ]
    plant, limits = {"initial_pose.yaw": 0.0}, {"linear.x.max_acceleration": ACCELERATION}
    with driven_by("laws_of_the_test:Failing", tmp_path, plant, **limits) as robot:
        for within, raises, reason in failures:
            assert robot.set_parameter("controller", "within", within).successful
            assert robot.set_parameter("controller", "raises", raises).successful
            drive(robot, (3.0, -5.5, 0.0))
            assert robot.state() == "goal not reached"
            assert values(robot.controller_states[-1])["reason"] == reason
            # Brought to rest within the limits of acceleration, 0.05 m/s in each period.
            speeds = [twist(command)[0] for command in robot.commands]
            last = len(speeds) - 1 - speeds[::-1].index(0.5)
            assert min(np.diff(speeds[last:])) == pytest.approx(-ACCELERATION * 0.1)
            assert speeds[-1] == 0.0
            robot.commands.clear()
        assert robot.processes["controller"].popen.poll() is None
        assert robot.processes["controller"].output.count("[ERROR]") == len(failures)
