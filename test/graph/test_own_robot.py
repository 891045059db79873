"""The parameter file of the how-to on one's own robot: the nodes know all of it, and a robot drives by it."""

import re
from pathlib import Path

import yaml
from robot import SIMULATED, distance, robot, turned, twist

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "how-to" / "own-robot.md").read_text()
(FILE,) = re.findall(r"^```yaml\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
HARMLESS = "/clock", "no fix yet"
"""in warnings while the nodes discover each other"""


def test_the_parameter_file_of_the_page_drives_to_a_goal_within_its_limits(tmp_path):
    (tmp_path / "my_robot.yaml").write_text(FILE)
    wheels = yaml.safe_load(FILE)["/**/ekf"]["ros__parameters"]
    plant = {name: wheels[name] for name in ("wheel_radius", "wheel_separation")}
    plant |= {"clock": "scaled", "real_time_factor": 1.0, "eps_x_max": 0.05, "eps_y_max": 0.05, "eps_theta_max": 0.05}
    plant |= {f"initial_pose.{name}": 0.0 for name in ("x", "y", "yaw")}
    goal = (0.6, 0.2, 0.5)
    file = ("--params-file", str(tmp_path / "my_robot.yaml"))
    with robot(plant, SIMULATED, SIMULATED, only=("robot", "plant"), joined=True, arguments=file) as running:
        running.send_goal(*goal)
        running.wait_for_state("goal reached")
        assert distance(running.true_pose(), goal) < 0.1
        assert turned(running.true_pose(), goal) < 0.1
        v, omega = zip(*map(twist, running.commands), strict=True)
        assert 0.1 < max(map(abs, v)) <= 0.2
        assert max(map(abs, omega)) <= 1.0
        warnings = [line for line in running.processes["robot"].output.splitlines() if "[WARN]" in line]
        assert not [line for line in warnings if not any(text in line for text in HARMLESS)]
