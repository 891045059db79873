"""The controller with laws of others: they reach goals, and one that fails leaves the robot standing and says why."""

import contextlib
import math
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
    answer: float = math.nan
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
            v = 1.0 / 0.0 if config.raises else config.answer
        return Memory(False), Twist(v, 0.0), Report(rho, 0.0, 0.0, 0.0, 0.0, 0, 0.0)
"""
DEAD_TIME, LAG, ACCELERATION, ANGULAR_ACCELERATION = 0.2, 0.1, 0.5, 1.5
SLUGGISH = {
    "command_delay": DEAD_TIME,
    "drive_time_constant": LAG,
    "acceleration_max": ACCELERATION,
    "angular_acceleration_max": ANGULAR_ACCELERATION,
}
DATA_SHEET = {
    "command_latency": DEAD_TIME,
    "drive_time_constant": LAG,
    "linear.x.max_acceleration": ACCELERATION,
    "angular.z.max_acceleration": ANGULAR_ACCELERATION,
}
GOALS = 20
SETTLED = 10
"""poses after ``goal reached`` before the true pose counts"""


@pytest.fixture
def laws(tmp_path):
    """A folder with the laws of this test."""
    (tmp_path / "laws_of_the_test.py").write_text(LAWS_OF_THE_TEST)
    return tmp_path


@contextlib.contextmanager
def driven_by(law, folder=EXAMPLES, plant=None, **parameters):
    """Run a robot in lock-step whose controller finds laws in ``folder``; it stands until it is let go."""
    path = os.pathsep.join((str(graph.SOURCE), str(folder)))
    with lockstep(plant, only=("ekf", "plant")) as robot:
        given = {"publish_when_idle": True, "reliable_inputs": True, **SIMULATED, "law": law, **parameters}
        robot.launch("controller", given, env=graph.environment(PYTHONPATH=path))
        robot.wait_until_ready("controller")
        yield robot


def drive(robot, goal, timeout=20.0):
    """Drive to a goal and stand there a while; return the true pose, with the plant paused."""
    robot.send_goal(*goal)
    robot.pause(False)
    robot.peer.spin_until(lambda: robot.state() in ("goal reached", "goal not reached"), timeout, f"an end at {goal}")
    count = len(robot.truths)
    robot.peer.spin_until(lambda: len(robot.truths) > count + SETTLED, 10.0, "a while at the goal")
    if robot.state() == "goal not reached":
        robot.peer.spin_until(lambda: twist(robot.commands[-1]) == (0.0, 0.0), 10.0, "the command to stand")
    robot.pause(True)
    return robot.true_pose()


@pytest.mark.parametrize("law", ["rotate_drive_rotate", "straight_line:StraightLine"])
def test_a_law_of_others_reaches_goals(law):
    with driven_by(law) as robot:
        for reached, goal in enumerate([(0.0, 0.0, 0.0), (-1.0, 1.5, 2.0)], 1):
            end = drive(robot, goal)
            assert distance(end, goal) <= 0.2
            assert turned(end, goal) <= 0.15
            said = values(robot.controller_states[-1])
            assert (said["law"], said["goals reached"]) == (law.split(":")[0], str(reached))
            assert not {"region", "switches", "eps_P [m]", "finish", "smallest tolerance [m]"} & set(said)
        refused = robot.set_parameter("controller", "law", "switching")
        assert not refused.successful
        assert "read-only" in refused.reason


def test_a_law_that_fails_stops_the_robot_and_the_next_goal_is_driven_to(laws):
    failures = [
        (2.0, False, "law failing failed: v = nan m/s, omega = 0.0 rad/s: must be finite"),
        (1.0, True, "law failing failed: ZeroDivisionError: float division by zero (laws_of_the_test.py:30)"),
    ]
    with driven_by("laws_of_the_test:Failing", laws, {"initial_pose.yaw": 0.0, **SLUGGISH}, **DATA_SHEET) as robot:
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


def test_a_bad_law_or_parameter_of_it_ends_the_node_at_the_start_in_one_line(laws):
    cases = {
        "dancing": "law = 'dancing': must be package.module:Class or one of aicardi, ",
        "laws_of_the_test:Failing -p speed:=7.0": "speed = 7.0: must be >= 0.1 and <= 1",
    }
    path = os.pathsep.join((str(graph.SOURCE), str(laws)))
    for text, line in cases.items():
        words = ("-p", *f"law:={text}".split())
        with graph.node(graph.MODULES["controller"], None, words, env=graph.environment(PYTHONPATH=path)) as process:
            assert process.wait(60.0) == 1
            assert process.output.count("\n") == 1
            assert process.output.startswith(f"error: {line}")


def random_goal(rng, pose):
    """0.5 to 6 m away, in any direction, with any heading; rounded, as the controller's status shows it."""
    bearing, way, heading = rng.uniform(-math.pi, math.pi), rng.uniform(0.5, 6.0), rng.uniform(-math.pi, math.pi)
    goal = pose[0] + way * math.cos(bearing), pose[1] + way * math.sin(bearing), heading
    return tuple(round(number, 3) for number in goal)


def test_a_sluggish_robot_with_a_data_sheet_reaches_every_goal():
    """0.2 s of dead time, 0.1 s of lag and bounded acceleration, all known to the controller."""
    rng, misses = np.random.default_rng(20), []
    with lockstep({"seed": 20, **SLUGGISH}, controller=DATA_SHEET) as robot:
        goal = (-2.0, -5.5, 0.5)
        for number in range(1, GOALS + 1):
            goal = random_goal(rng, goal)
            pose = drive(robot, goal)
            errors = distance(pose, goal), turned(pose, goal)
            print(f"goal {number}: {errors[0]:.3f} m, {errors[1]:.3f} rad, {robot.state()}")
            if max(errors) > 0.1 or robot.state() != "goal reached":
                misses.append((number, goal, errors, robot.state()))
    assert misses == []
