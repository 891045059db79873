"""The processes of a launch: each argument is checked, and reaches exactly the nodes that need it."""

import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from diffbot_bag.parameters import RecorderConfig
from diffbot_control.ros.parameters.controller import ControllerNodeConfig
from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_core.errors import DiffbotError
from diffbot_core.kinematics import WheelGeometry
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
SYSTEM_TIME, SIMULATED_TIME = {"use_sim_time": False}, {"use_sim_time": True}


def robot(**texts):
    return plan(parse(ROBOT, texts), ROOT, simulate=False)


def simulation(**texts):
    return plan(parse(SIMULATION, {"description": "false", **texts}), ROOT, simulate=True)


def parameters(nodes):
    return {node.name: dict(node.parameters) for node in nodes}


def test_a_robot_gets_filter_and_controller_and_a_simulation_the_plant_too():
    assert list(parameters(robot())) == ["ekf", "controller"]
    assert list(parameters(simulation())) == ["ekf", "controller", "plant"]
    assert parameters(robot(localization="false", use_sim_time="true")) == {"controller": SIMULATED_TIME}


def test_each_argument_reaches_its_nodes(tmp_path):
    nodes = simulation(
        preset="paper", cmd_vel_type="twist_stamped", x="1.0", y="2.0", yaw="0.5", seed="3", frame_prefix="r1/",
        autostart="false", bag=str(tmp_path / "run"),
    )  # fmt: skip
    assert nodes[0].name == "recorder", "the recorder must start first"
    prefix, stamped = {**SYSTEM_TIME, "frame_prefix": "r1/"}, {"cmd_vel_type": "twist_stamped"}
    assert parameters(nodes) == {
        "recorder": {**SYSTEM_TIME, "uri": str(tmp_path / "run")},
        "ekf": {**prefix, "autostart": False},
        "controller": {**prefix, **stamped, "preset": "paper", "autostart": False},
        "plant": {
            **prefix, **stamped, "clock": "wall", "initial_pose.x": 1.0, "initial_pose.y": 2.0, "initial_pose.yaw": 0.5,
            "seed": 3,
        },
    }  # fmt: skip
    for node in nodes:
        build(CONFIGS[node.name], {name: value for name, value in node.parameters.items() if name != "use_sim_time"})


def test_all_nodes_follow_the_clock_of_the_plant():
    assert parameters(simulation(clock="scaled", real_time_factor="2")) == {
        "ekf": SIMULATED_TIME,
        "controller": SIMULATED_TIME,
        "plant": {**SYSTEM_TIME, "clock": "scaled", "real_time_factor": 2.0},
    }


def test_in_lockstep_inputs_are_reliable_and_commands_are_stamped():
    follower, stamped = {**SIMULATED_TIME, "reliable_inputs": True}, {"cmd_vel_type": "twist_stamped"}
    assert parameters(simulation(clock="lockstep")) == {
        "ekf": follower,
        "controller": {**follower, **stamped, "publish_when_idle": True},
        "plant": {**SYSTEM_TIME, **stamped, "clock": "lockstep"},
    }
    docking = simulation(cmd_vel_type="twist_stamped", docking="true")[-1]
    assert (docking.executable, dict(docking.parameters)) == ("docking_node", {**SYSTEM_TIME, **stamped})
    with pytest.raises(DiffbotError, match="only one node may publish cmd_vel"):
        simulation(clock="lockstep", docking="true")


def test_with_docking_two_controllers_are_allowed_unless_the_file_sets_their_number(tmp_path):
    name, file = "max_cmd_vel_publishers", tmp_path / "robot.yaml"
    for composed, nodes in (("false", {"controller", "plant"}), ("true", {"robot_node", "plant"})):
        found = {(one.name or one.executable): one.parameters for one in simulation(docking="true", composed=composed)}
        assert {key: one[name] for key, one in found.items() if name in one} == dict.fromkeys(nodes, 2)
    assert not any(name in one.parameters for one in simulation())
    file.write_text(f"/**/controller: {{ros__parameters: {{{name}: 3}}}}\n")
    assert not any(name in one.parameters for one in robot(docking="true", parameters=str(file)))


def test_only_nodes_that_a_parameter_file_names_get_it(tmp_path):
    assert {node.files for node in robot()} == {(str(ROOT / "config" / "diffbot.yaml"),)}
    file = tmp_path / "robot.yaml"
    # A node whose name is misspelt in the file must get the file, to report the error.
    for section, names in (
        ("/**", ["ekf", "controller"]),
        ("/r1/ekf", ["ekf"]),
        ("/**/controler", ["controller"]),
    ):
        file.write_text(f"{section}: {{ros__parameters: {{}}}}")
        assert [node.name for node in robot(parameters=str(file)) if node.files == (str(file),)] == names


def test_a_simulation_stays_on_its_host_and_a_robot_is_restricted_on_request():
    name = "ROS_AUTOMATIC_DISCOVERY_RANGE"

    def set_by(arguments, texts, outer):
        return environment(parse(arguments, texts), outer, simulate=arguments is SIMULATION).get(name)

    assert set_by(ROBOT, {}, {}) is None
    assert set_by(ROBOT, {"discovery_range": "off"}, {name: "SUBNET"}) == "OFF"
    assert set_by(SIMULATION, {}, {}) == set_by(SIMULATION, {}, {name: ""}) == "LOCALHOST"
    assert set_by(SIMULATION, {}, {name: "SUBNET"}) is None, "the environment of the launch wins"
    assert set_by(SIMULATION, {"discovery_range": "subnet"}, {}) == "SUBNET"


def test_arguments_that_exclude_each_other_and_files_that_are_missing_are_refused_in_one_line(tmp_path):
    for texts, line in (
        ({"composed": "true", "localization": "false"}, "composed = True: must be false with localization:=false"),
        ({"urdf": "/robot.urdf"}, "urdf = '/robot.urdf': must be given with description:=true"),
        ({"parameters": str(tmp_path / "none.yaml")}, "parameter file: cannot open"),
        ({"description": "true", "urdf": str(tmp_path / "none.urdf")}, "cannot open"),
    ):
        with pytest.raises(DiffbotError) as refused:
            simulation(**texts)
        assert str(refused.value).startswith(line)
        assert "\n" not in str(refused.value)


def test_the_path_of_a_bag_is_relative_to_the_folder_of_the_launch(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    assert parse(ROBOT, {"bag": "run"})["bag"] == str(tmp_path / "run")
    assert parse(ROBOT, {"bag": "~/run"})["bag"] == str(tmp_path / "home" / "run")


@pytest.mark.parametrize(("side", "sign"), [("left", 1), ("right", -1)])
def test_the_wheels_of_the_urdf_are_the_default_wheels(side, sign):
    urdf = ET.parse(ROOT / "urdf" / "diffbot.urdf").getroot()
    wheels, plant = WheelGeometry(), PlantNodeConfig()
    joint = urdf.find(f"joint[@name='{getattr(plant, f'{side}_wheel_name')}']")
    assert joint.get("type") == "continuous"
    assert joint.find("parent").get("link") == plant.base_link_frame
    # base_link is on the ground. The wheels touch the ground and turn about +y.
    position = [float(word) for word in joint.find("origin").get("xyz").split()]
    assert position == [0.0, sign * wheels.wheel_separation / 2, wheels.wheel_radius]
    assert [float(word) for word in joint.find("axis").get("xyz").split()] == [0.0, 1.0, 0.0]
    link = urdf.find(f"link[@name='{joint.find('child').get('link')}']")
    assert {float(shape.get("radius")) for shape in link.iter("cylinder")} == {wheels.wheel_radius}
