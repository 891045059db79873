"""The launch files with fake classes in place of ROS's launch, which pip cannot install."""

import importlib.util
import sys
import types
from pathlib import Path
from types import SimpleNamespace

import pytest
import yaml
from ament_index_python.packages import PackageNotFoundError

from diffbot_core.errors import DiffbotError, InvalidValueError
from diffbot_tools.bringup import REQUIRED, ROBOT, SIMULATION

ROOT = Path(__file__).resolve().parents[2]
MODULE = "diffbot_tools.launch_files"
NAMES = {
    "launch": ("LaunchContext", "LaunchDescription"),
    "launch.actions": ("DeclareLaunchArgument", "LogInfo", "OpaqueFunction", "SetEnvironmentVariable"),
    "launch.substitutions": ("LaunchConfiguration",),
    "launch_ros": (),
    "launch_ros.actions": ("Node",),
    "launch_ros.parameter_descriptions": ("ParameterValue",),
}


class Fake:
    """Any class of launch; keeps its arguments."""

    def __init__(self, *arguments, **options):
        self.arguments, self.options = arguments, options

    def perform(self, context):
        return context.texts[self.arguments[0]]


@pytest.fixture
def load(monkeypatch):
    """Return a function that returns the entities of a launch file."""
    for name, classes in NAMES.items():
        module = types.ModuleType(name)
        for one in classes:
            setattr(module, one, type(one, (Fake,), {}))
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.delitem(sys.modules, MODULE, raising=False)

    def description(name):
        spec = importlib.util.spec_from_file_location("launch_file", ROOT / "launch" / name)
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        monkeypatch.setattr(sys.modules[MODULE], "get_package_share_directory", lambda package: str(ROOT))
        monkeypatch.setattr(sys.modules[MODULE], "get_package_prefix", installed("diffbot"))
        return module.generate_launch_description().arguments[0]

    yield description
    sys.modules.pop(MODULE, None)


def actions(entities, **texts):
    """Return the actions for these arguments, except the discovery range of a simulation and its log line."""
    *declared, function = entities
    defaults = {one.arguments[0]: one.options["default_value"] for one in declared}
    found = function.options["function"](SimpleNamespace(texts={**defaults, **texts}, is_shutdown=False))
    return [one for one in found if type(one).__name__ not in ("SetEnvironmentVariable", "LogInfo")]


def installed(*packages):
    """Return a get_package_prefix of ament that finds only these packages."""

    def prefix(package):
        if package not in packages:
            raise PackageNotFoundError(package)
        return "/opt/ros/jazzy"

    return prefix


@pytest.mark.parametrize(("name", "arguments"), [("robot.launch.py", ROBOT), ("simulation.launch.py", SIMULATION)])
def test_every_argument_is_declared_and_checked_before_anything_starts(load, name, arguments):
    entities = load(name)
    *declared, _ = entities
    assert [one.arguments[0] for one in declared] == [one.name for one in arguments]
    choices = {one.arguments[0]: one.options["choices"] for one in declared}
    assert choices["log_level"] == ["debug", "info", "warn", "error", "fatal"]
    with pytest.raises(InvalidValueError, match=r"^composed = "):
        actions(entities, composed="true", localization="false")
    with pytest.raises(DiffbotError, match=r"^the package rviz2 is not installed$"):
        actions(entities, rviz="true")


LIMITS = dict.fromkeys(REQUIRED, 0.5)


def parameter_file(path, limits, node="/**/controller"):
    path.write_text(yaml.safe_dump({node: {"ros__parameters": limits}}))
    return str(path)


def test_a_robot_without_one_of_its_limits_is_not_started_and_a_simulated_one_is(load, tmp_path):
    some = {name: value for name, value in LIMITS.items() if name != "linear.x.max_velocity"}
    file = parameter_file(tmp_path / "robot.yaml", some)
    with pytest.raises(DiffbotError, match=r"robot\.yaml: /\*\*/controller lacks linear\.x\.max_velocity:"):
        actions(load("robot.launch.py"), parameters=file)
    # Limits of another node do not count.
    other = parameter_file(tmp_path / "other.yaml", LIMITS, "/**/ekf")
    with pytest.raises(DiffbotError, match=r"has no section /\*\*/controller"):
        actions(load("robot.launch.py"), parameters=other)
    with pytest.raises(DiffbotError, match=r"has no section /\*\*/dock_controller"):
        actions(load("robot.launch.py"), parameters=parameter_file(tmp_path / "all.yaml", LIMITS), docking="true")
    assert actions(load("simulation.launch.py"), parameters=file, description="false")


def test_nodes_get_texts_verbatim_and_numbers_as_numbers(load, tmp_path):
    nodes = actions(
        load("simulation.launch.py"), bag=str(tmp_path / "2026"), namespace="r1", x="1.5", description="false"
    )
    recorder, plant = nodes[0].options, nodes[-1].options
    assert (recorder["package"], recorder["executable"], recorder["name"]) == ("diffbot", "recorder_node", "recorder")
    (values,) = recorder["parameters"]  # without the file, which has no section for the recorder
    assert Path(plant["parameters"][0]).name == "diffbot.yaml"
    assert values["uri"].arguments == (str(tmp_path / "2026"),)
    assert values["uri"].options == {"value_type": str}
    assert plant["parameters"][1]["initial_pose.x"] == 1.5
    assert {node.options["namespace"] for node in nodes} == {"r1"}
    own_tf = (("/tf", "tf"), ("/tf_static", "tf_static"))
    assert [tuple(node.options["remappings"]) for node in nodes] == [(), own_tf, own_tf, own_tf]
