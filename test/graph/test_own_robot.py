"""The parameter file that ``diffbot robot new`` writes: the nodes know all of it, and a robot drives by it."""

import re

import yaml
from inside import inside
from robot import distance, turned, twist

from diffbot_tools.robot.description import RobotDescription, file_of_robot

FILE = file_of_robot(RobotDescription(gyro=True), "my_robot.yaml")
WARNING = re.compile(r"\[(WARN|ERROR|FATAL)\] \[[\d.]+\] \[(controller|ekf|plant)[].]")
HARMLESS = "/clock", "no fix yet", "no odometry yet"
"""in warnings while the nodes discover each other"""


def test_the_written_file_drives_to_a_goal_within_its_limits(tmp_path, capfd):
    (tmp_path / "my_robot.yaml").write_text(FILE)
    assert set(yaml.safe_load(FILE)) == {"/**", "/**/controller", "/**/ekf", "/**/plant"}
    goal = (0.6, 0.2, 0.5)
    with inside({}, arguments=("--params-file", str(tmp_path / "my_robot.yaml"))) as robot:
        robot.send_goal(*goal)
        robot.run(lambda: robot.state() == "goal reached", "the arrival")
        assert distance(robot.true_pose(), goal) < 0.1
        assert turned(robot.true_pose(), goal) < 0.1
        v, omega = zip(*map(twist, robot.commands), strict=True)
    assert 0.1 < max(map(abs, v)) <= 0.2
    assert max(map(abs, omega)) <= 2.0
    # Of these nodes only: rcl also warns if a node of an earlier test with the same name is not yet garbage-collected.
    warnings = [line for line in "".join(capfd.readouterr()).splitlines() if WARNING.match(line)]
    assert not [line for line in warnings if not any(text in line for text in HARMLESS)]
