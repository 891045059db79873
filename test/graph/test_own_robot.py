"""The how-tos on the robot and on troubleshooting: the file drives a robot, the tables have the code's texts."""

import ast
import contextlib
import re
from pathlib import Path

import graph
import page_tables
import pytest
import yaml
from geometry_msgs.msg import Twist
from robot import SIMULATED, Robot, distance, turned, twist

from diffbot_bag.parameters import RecorderConfig
from diffbot_control import ekf_node
from diffbot_control.law.supervisor import STATES
from diffbot_control.ros.controller_parameters import ControllerNodeConfig
from diffbot_control.ros.ekf_parameters import EkfNodeConfig
from diffbot_core.ros.managed_node import INACTIVE
from diffbot_core.schema import build, parameters_of
from diffbot_lab.bringup.arguments import ROBOT, SIMULATION
from diffbot_sim.ros.parameters import PlantNodeConfig

ROOT = Path(__file__).resolve().parents[2]
HOW_TO = ROOT / "docs" / "how-to"
PAGE = (HOW_TO / "own-robot.md").read_text()
HELP = "\n".join((HOW_TO / f"troubleshooting{part}.md").read_text() for part in ("", "-messages"))
(FILE,) = re.findall(r"^```yaml\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
CONFIGS = {
    "ekf": EkfNodeConfig,
    "controller": ControllerNodeConfig,
    "plant": PlantNodeConfig,
    "recorder": RecorderConfig,
}
MESSAGES = {"cmd_vel", "global_pose", "joint_states", "base_link", "child_frame_id", "frame_id", "my_robot.yaml"}
"""Words with an underscore on the page that are neither parameters nor arguments."""


def rows(heading):
    """Return the cells of the tables whose first header cell is ``heading``, without their heads."""
    return [row for table in page_tables.tables(HELP) if table[0][0] == heading for row in table[1:]]


def texts_of_the_code():
    """Return every text in the code of control as a pattern: what an f-string fills in may be any word."""
    found = set()
    for path in (ROOT / "diffbot_control").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                found.add(re.escape(node.value))
            elif isinstance(node, ast.JoinedStr):
                parts = [re.escape(one.value) if isinstance(one, ast.Constant) else r"\w+" for one in node.values]
                # Several texts follow each other in a message of /diagnostics, separated by "; ".
                found.add("".join(parts).split(";")[0])
    return found


def test_every_state_has_its_row():
    states = [(node, message.strip("`")) for node, message, *_ in rows("node") if node in ("controller", "ekf")]
    ekf = [INACTIVE, ekf_node.WAITING, ekf_node.RUNNING, ekf_node.SILENT, ekf_node.CONTRADICTED]
    controller = [INACTIVE, *STATES]
    assert sorted(states) == sorted([("controller", one) for one in controller] + [("ekf", one) for one in ekf])


def texts_of_the_page():
    return [text for row in rows("text") for text in re.findall("`([^`]+)`", row[0])]


@pytest.mark.parametrize("text", texts_of_the_page())
def test_texts_of_diagnostics_are_those_of_the_code(text):
    # A text of one filled-in word would match anything.
    patterns = [one for one in texts_of_the_code() if re.search(r"[a-z]{3}", one.replace(r"\w+", ""))]
    assert any(re.fullmatch(one, text) for one in patterns)


def test_every_reason_to_drop_a_message_has_its_row():
    calls = [
        node
        for path in (ROOT / "diffbot_control").rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "BadMessageError"
    ]
    kinds = {one.args[0].value for one in calls if isinstance(one.args[0], ast.Constant)}
    assert len(kinds) > 20
    assert kinds - set(texts_of_the_page()) == set()


def test_a_text_that_no_node_publishes_is_found_out():
    assert not any(re.fullmatch(one, "no fix as yet") for one in texts_of_the_code())


def test_parameters_and_arguments_on_the_page_exist():
    parameters = {one.name for config in CONFIGS.values() for one in parameters_of(config)}
    known = parameters | {one.name for one in (*ROBOT, *SIMULATION)} | MESSAGES | {"use_sim_time"}
    words = {word.partition(":")[0] for word in re.findall(r"`([a-z_.]+(?::=?[^`]*)?)`", PAGE + HELP)}
    assert {word for word in words if "_" in word} <= known
    assert {word for word in re.findall(r"(\w+):=", PAGE + HELP)} <= known | {"odom"}


def test_the_parameter_file_sets_what_the_nodes_know():
    for name, values in yaml.safe_load(FILE).items():
        build(CONFIGS[name.removeprefix("/**/")], values["ros__parameters"])


@pytest.fixture
def driving(tmp_path):
    """The nodes with the file of the page on a simulated robot of those wheels, at five times the wall clock."""
    file = tmp_path / "my_robot.yaml"
    file.write_text(FILE)
    wheels = yaml.safe_load(FILE)["/**/ekf"]["ros__parameters"]
    plant = {name: wheels[name] for name in ("wheel_radius", "wheel_separation")}
    plant |= {"clock": "scaled", "real_time_factor": 5.0, "eps_x_max": 0.05, "eps_y_max": 0.05, "eps_theta_max": 0.05}
    plant |= {f"initial_pose.{name}": 0.0 for name in ("x", "y", "yaw")}
    with contextlib.ExitStack() as stack:
        running = Robot(stack, stack.enter_context(graph.peer()), "")
        running.launch("plant", plant)
        for name in ("ekf", "controller"):
            node = graph.node(graph.MODULES[name], SIMULATED, ("--params-file", str(file)))
            running.processes[name] = stack.enter_context(node)
        running.commands = running.peer.subscribe(Twist, "cmd_vel", 1000)
        running.wait_until_ready("plant", "ekf", "controller")
        yield running


def test_the_parameter_file_drives_to_a_goal_within_its_limits(driving):
    goal = (0.6, 0.2, 0.5)
    driving.send_goal(*goal)
    driving.wait_for_state("goal reached", 30.0)
    assert distance(driving.true_pose(), goal) < 0.1
    assert turned(driving.true_pose(), goal) < 0.1
    v, omega = zip(*map(twist, driving.commands), strict=True)
    assert 0.1 < max(map(abs, v)) <= 0.2
    assert max(map(abs, omega)) <= 1.0
    for name in ("ekf", "controller"):
        # What may be said while the nodes find each other is nothing about the file.
        start = "/clock", "no fix yet"
        lines = driving.processes[name].output.splitlines()
        assert [one for one in lines if "[WARN]" in one and not any(text in one for text in start)] == []
