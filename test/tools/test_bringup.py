"""The nodes of a launch: that each argument is checked, and reaches those nodes that need it and no other."""

from pathlib import Path

import pytest

from diffbot_bag.parameters import RecorderConfig
from diffbot_control.ros.parameters.controller import ControllerNodeConfig
from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_core.errors import DiffbotError
from diffbot_core.schema import build
from diffbot_sim.parameters import PlantNodeConfig
from diffbot_tools.bringup import ROBOT, SIMULATION, environment, parse, plan

ROOT = Path(__file__).resolve().parents[2]
CONFIGS = {
    "recorder": RecorderConfig,
    "ekf": EkfNodeConfig,
    "controller": ControllerNodeConfig,
    "plant": PlantNodeConfig,
}


def robot(**texts):
    return plan(parse(ROBOT, texts), ROOT, simulate=False)


def simulation(**texts):
    return plan(parse(SIMULATION, {"description": "false", **texts}), ROOT, simulate=True)


def executables(nodes):
    return [node.executable for node in nodes]


def parameters(nodes):
    return {node.name: dict(node.parameters) for node in nodes}


def test_a_robot_gets_filter_and_controller_and_a_simulation_the_plant_too():
    assert executables(robot()) == ["ekf_node", "controller_node"]
    assert executables(simulation()) == ["ekf_node", "controller_node", "plant_node"]
    assert executables(robot(localization="false")) == ["controller_node"]
    assert parameters(robot(use_sim_time="true")) == {
        "ekf": {"use_sim_time": True},
        "controller": {"use_sim_time": True},
    }


def test_each_argument_reaches_its_nodes(tmp_path):
    nodes = simulation(
        preset="paper", cmd_vel_type="twist_stamped", x="1.0", y="2.0", yaw="0.5", seed="3", frame_prefix="r1/",
        autostart="false", bag=str(tmp_path / "run"),
    )  # fmt: skip
    assert nodes[0].name == "recorder", "it starts first"
    wall = {"use_sim_time": False}
    assert parameters(nodes) == {
        "recorder": {**wall, "uri": str(tmp_path / "run")},
        "ekf": {**wall, "frame_prefix": "r1/", "autostart": False},
        "controller": {
            **wall, "preset": "paper", "cmd_vel_type": "twist_stamped", "frame_prefix": "r1/", "autostart": False,
        },
        "plant": {
            **wall, "clock": "wall", "cmd_vel_type": "twist_stamped", "frame_prefix": "r1/", "initial_pose.x": 1.0,
            "initial_pose.y": 2.0, "initial_pose.yaw": 0.5, "seed": 3,
        },
    }  # fmt: skip
    for node in nodes:
        build(CONFIGS[node.name], {name: value for name, value in node.parameters.items() if name != "use_sim_time"})


@pytest.mark.parametrize(
    ("clock", "reliable", "idle", "stamped"),
    [
        ("scaled", {}, {}, {}),
        ("lockstep", {"reliable_inputs": True}, {"publish_when_idle": True}, {"cmd_vel_type": "twist_stamped"}),
    ],
)
def test_all_follow_the_clock_of_the_plant_that_publishes_it(clock, reliable, idle, stamped):
    assert parameters(simulation(clock=clock, real_time_factor="2")) == {
        "ekf": {"use_sim_time": True, **reliable},
        "controller": {"use_sim_time": True, **reliable, **idle, **stamped},
        "plant": {"use_sim_time": False, "clock": clock, "real_time_factor": 2.0, **stamped},
    }


def test_the_parameter_file_is_the_packages_or_the_users(tmp_path):
    assert {node.files for node in robot()} == {(str(ROOT / "config" / "diffbot.yaml"),)}
    mine = tmp_path / "mine.yaml"
    # Only the nodes that it is for: another one would refuse it. One that it nearly names says so itself.
    for section, executables in (
        ("/**", ["ekf", "controller"]),
        ("/r1/ekf", ["ekf"]),
        ("/**/controler", ["controller"]),
    ):
        mine.write_text(f"{section}: {{ros__parameters: {{}}}}")
        nodes = robot(parameters=str(mine))
        assert [node.name for node in nodes if node.files == (str(mine),)] == executables


def test_a_simulation_stays_on_its_host_and_a_robot_is_restricted_on_request():
    name = "ROS_AUTOMATIC_DISCOVERY_RANGE"

    def set_by(arguments, texts, outer):
        return environment(parse(arguments, texts), outer, simulate=arguments is SIMULATION).get(name)

    assert set_by(ROBOT, {}, {}) is None
    assert set_by(ROBOT, {"discovery_range": "off"}, {name: "SUBNET"}) == "OFF"
    assert set_by(SIMULATION, {}, {}) == set_by(SIMULATION, {}, {name: ""}) == "LOCALHOST"
    assert set_by(SIMULATION, {}, {name: "SUBNET"}) is None, "what the user has set stays"
    assert set_by(SIMULATION, {"discovery_range": "subnet"}, {}) == "SUBNET"


def test_arguments_that_exclude_each_other_and_files_that_are_missing_are_refused_in_one_line(tmp_path):
    for texts, line in (
        ({"composed": "true", "localization": "false"}, "composed = True: must be false with localization:=false"),
        ({"parameters": str(tmp_path / "none.yaml")}, "parameter file: cannot open"),
        ({"description": "true", "urdf": str(tmp_path / "none.urdf")}, "cannot open"),
    ):
        with pytest.raises(DiffbotError) as refused:
            simulation(**texts)
        assert str(refused.value).startswith(line)
        assert "\n" not in str(refused.value)


def test_a_bag_is_a_folder_in_that_of_the_launch(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    assert parse(ROBOT, {"bag": "run"})["bag"] == str(tmp_path / "run")
    assert parse(ROBOT, {"bag": "~/run"})["bag"] == str(tmp_path / "home" / "run")


def test_every_node_in_lockstep_receives_reliably():
    nodes = simulation(clock="lockstep", docking="true")
    assert {one.executable for one in nodes if one.parameters.get("reliable_inputs")} == {
        "ekf_node", "controller_node", "docking_node"
    }  # fmt: skip
