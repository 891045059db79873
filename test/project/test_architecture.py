"""What no linter checks of the rooms: import-linter (`make lint`) holds who may import whom, ruff what is explained."""

import ast
import json
import subprocess
import sys
from pathlib import Path

import pytest

import diffbot_core

ROOT = Path(__file__).resolve().parents[2]
INSTALLED = Path(diffbot_core.__file__).resolve().parent.parent
PACKAGES = ("diffbot_core", "diffbot_control", "diffbot_bag", "diffbot_sim", "diffbot_lab")
MAX_LINES, MAX_FUNCTION = 300, 40
SOURCES = {
    str(path.relative_to(ROOT)): path.read_text(encoding="utf-8")
    for package in PACKAGES
    for path in sorted((ROOT / package).rglob("*.py"))
}
MODULES = [name.removesuffix(".py").removesuffix("/__init__").replace("/", ".") for name in SOURCES]
ROS = {
    "action_msgs", "ament_index_python", "builtin_interfaces", "diagnostic_msgs", "geometry_msgs", "launch",
    "launch_ros", "lifecycle_msgs", "nav_msgs", "rcl_interfaces", "rclpy", "rosbag2_py", "rosgraph_msgs",
    "rosidl_runtime_py", "rpyutils", "sensor_msgs", "std_msgs", "std_srvs", "tf2_msgs", "tf2_ros",
}  # fmt: skip


def uses_ros(module):
    """Return whether this module is one of the places of ROS: rooms named ``ros``, nodes, the conversions of bags."""
    _, *rooms = module.split(".")
    return "ros" in rooms or module.endswith("_node") or module == "diffbot_bag.ros_conversions"


def interpret(program):
    """Run a program in an interpreter of its own; return the JSON that it prints."""
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, cwd=INSTALLED, capture_output=True, text=True, timeout=100, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def loaded_by(module):
    """Return the outermost names of what is loaded once ``module`` is imported."""
    program = f"import json, sys, {module}; print(json.dumps(sorted({{m.split('.')[0] for m in sys.modules}})))"
    return set(interpret(program))


def test_all_five_packages_are_looked_at():
    assert {module.split(".")[0] for module in MODULES} == set(PACKAGES)
    nodes = [module for module in MODULES if module.endswith("_node")]
    assert {"diffbot_control.controller_node", "diffbot_bag.recorder_node", "diffbot_lab.demo.demo_node"} <= set(nodes)


def test_pure_modules_live_without_ros():
    """In an interpreter that finds no ROS, every module outside the places of ROS can be imported."""
    pure = [module for module in MODULES if not uses_ros(module)]
    assert len(pure) > 60
    program = f"""
import importlib, json, sys

class NoRos:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {ROS!r}:
            raise ImportError(f"{{name}}: there is no ROS here")

sys.meta_path.insert(0, NoRos())
refused = {{}}
for name in {pure!r}:
    try:
        importlib.import_module(name)
    except ImportError as error:
        refused[name] = str(error)
print(json.dumps(refused))
"""
    assert interpret(program) == {}


def test_the_law_loads_neither_arrays_nor_the_filter():
    law = [module for module in MODULES if module.startswith("diffbot_control.law")]
    assert len(law) > 5
    assert loaded_by(", ".join(law)) & ({"numpy", "scipy", "filterpy", "numba", "yaml"} | ROS) == set()


@pytest.mark.parametrize(
    "node", ["diffbot_control.controller_node", "diffbot_sim.plant_node", "diffbot_bag.recorder_node"]
)
def test_a_node_without_a_filter_loads_no_libraries_of_one(node):
    loaded = loaded_by(node)
    assert "rclpy" in loaded
    assert loaded & {"scipy", "filterpy", "matplotlib", "numba", "pandas", "tqdm", "pyarrow"} == set()


def test_an_executable_is_light_until_it_is_launched():
    rooms = [module for module in MODULES if module.endswith(".executables")]
    assert len(rooms) == 4
    loaded = loaded_by(", ".join(rooms))
    assert loaded & ({"numpy", "yaml", "mcap", "zstandard"} | ROS) == set()


def test_no_file_is_too_long_to_be_read_at_once():
    lengths = {name: text.count("\n") for name, text in SOURCES.items()}
    assert {name: length for name, length in lengths.items() if length > MAX_LINES} == {}


def functions_of(tree):
    kinds = (ast.FunctionDef, ast.AsyncFunctionDef)
    return [node for node in ast.walk(tree) if isinstance(node, kinds)]


def length(function):
    """Return the lines of a function, docstring included."""
    return function.end_lineno - function.lineno + 1


def test_functions_fit_on_a_screen():
    long = {
        f"{name}: {function.name}": length(function)
        for name, text in SOURCES.items()
        for function in functions_of(ast.parse(text, name))
        if length(function) > MAX_FUNCTION
    }
    assert long == {}
