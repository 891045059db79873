"""Nav2's graceful controller as a law, against recorded commands of its compiled code (nav2_graceful.json)."""

import json
from pathlib import Path

import pytest
from driven import seen

from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist
from diffbot_lab.laws.nav2_graceful import Nav2Graceful, Nav2GracefulConfig, check_goal, nav2_graceful, new_plan

RECORDED = json.loads(Path(__file__).with_name("nav2_graceful.json").read_text())
ORIGIN = Pose(0.0, 0.0, 0.0)


@pytest.mark.parametrize("drive", RECORDED["drives"], ids=range(len(RECORDED["drives"])))
def test_each_command_equals_the_command_of_the_compiled_controller(drive):
    """The tolerance allows for Nav2's distances and angles in single precision."""
    values = {("lambda_" if name == "lambda" else name): value for name, value in drive["parameters"].items()}
    stop = Nav2GracefulConfig().stop._replace(stop_distance=values.pop("stop_distance"))
    config, plan = Nav2GracefulConfig(**values, stop=stop), None
    for number, (x, y, theta, v, omega) in enumerate(drive["steps"]):
        if number % RECORDED["steps_of_a_plan"] == 0:
            plan = new_plan(x, y, 0.0)
        plan, command = nav2_graceful(plan, Pose(x, y, theta), config)
        assert command == pytest.approx((v, omega), abs=2e-6)


def test_the_path_is_planned_every_second():
    config = Nav2GracefulConfig()
    memory = Nav2Graceful.new_memory(config)
    ages = []
    for number in range(25):
        pose = Pose(-3.0 + 0.04 * number, 0.0, 0.0)
        memory, _, _ = Nav2Graceful.step(memory, seen(pose, dt=0.1 if number else 0.0), ORIGIN, config)
        ages.append(round(memory.state.age, 3))
    assert [number for number, age in enumerate(ages) if age == 0.0] == [0, 10, 20]


def test_the_goal_checker_checks_the_position_once_and_the_end_is_final():
    config = Nav2GracefulConfig()
    drive = check_goal(new_plan(-1.0, 0.0, 0.0), Pose(0.05, 0.0, 1.0), config.stop)
    assert (drive.checked, drive.done) == (True, False)
    assert check_goal(drive, Pose(0.5, 0.0, 0.04), config.stop).done
    assert not check_goal(new_plan(-1.0, 0.0, 0.0), Pose(0.5, 0.0, 0.0), config.stop).done
    memory = Nav2Graceful.new_memory(config)
    for pose in (ORIGIN, Pose(2.0, 1.0, 1.0)):
        memory, command, _ = Nav2Graceful.step(memory, seen(pose), ORIGIN, config)
        assert command == Twist(0.0, 0.0)
