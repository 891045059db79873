"""The parameter file of the how-to on one's own robot: the nodes know all of it, and a robot drives by it."""

import re
from pathlib import Path

import yaml
from inside import inside
from robot import distance, turned, twist

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "how-to" / "own-robot.md").read_text()
(FILE,) = re.findall(r"^```yaml\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
HARMLESS = "/clock", "no fix yet"
"""in warnings while the nodes discover each other"""


def test_the_parameter_file_of_the_page_drives_to_a_goal_within_its_limits(tmp_path, capfd):
    (tmp_path / "my_robot.yaml").write_text(FILE)
    wheels = yaml.safe_load(FILE)["/**/ekf"]["ros__parameters"]
    plant = {name: wheels[name] for name in ("wheel_radius", "wheel_separation")}
    plant |= dict.fromkeys(("eps_x_max", "eps_y_max", "eps_theta_max"), 0.05)
    plant |= {f"initial_pose.{name}": 0.0 for name in ("x", "y", "yaw")}
    goal = (0.6, 0.2, 0.5)
    with inside(plant, arguments=("--params-file", str(tmp_path / "my_robot.yaml"))) as robot:
        robot.send_goal(*goal)
        robot.run(lambda: robot.state() == "goal reached", "the arrival")
        assert distance(robot.true_pose(), goal) < 0.1
        assert turned(robot.true_pose(), goal) < 0.1
        v, omega = zip(*map(twist, robot.commands), strict=True)
    assert 0.1 < max(map(abs, v)) <= 0.2
    assert max(map(abs, omega)) <= 1.0
    warnings = [line for line in "".join(capfd.readouterr()).splitlines() if "[WARN]" in line]
    assert not [line for line in warnings if not any(text in line for text in HARMLESS)]
