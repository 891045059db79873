"""The rooms of the house: who imports whom, who knows ROS, and what is written at each door."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import diffbot_control

ROOT = Path(__file__).resolve().parents[2]
INSTALLED = Path(diffbot_control.__file__).resolve().parent.parent
# From the ground up: each floor may use those below it.
FLOORS = ("diffbot_control", "diffbot_bag", "diffbot_sim")
ROS = {
    "action_msgs",
    "ament_index_python",
    "builtin_interfaces",
    "diagnostic_msgs",
    "geometry_msgs",
    "launch",
    "launch_ros",
    "nav_msgs",
    "rcl_interfaces",
    "rclpy",
    "rosbag2_interfaces",
    "rosbag2_py",
    "rosgraph_msgs",
    "rosidl_runtime_py",
    "rpyutils",
    "sensor_msgs",
    "std_msgs",
    "std_srvs",
    "tf2_msgs",
    "tf2_ros",
    "unique_identifier_msgs",
    "visualization_msgs",
}
MODULES = {
    f"{floor}.{path.stem}": ast.parse(path.read_text(encoding="utf-8"), str(path))
    for floor in FLOORS
    for path in sorted((ROOT / floor).glob("*.py"))
}


def knows_ros(module):
    last = module.rpartition(".")[2]
    return last.endswith("_node") or last.startswith("ros_")


PURE = sorted(module for module in MODULES if not knows_ros(module))


def imports_of(module):
    """Return the full names of all modules that may be imported by this one, wherever the import stands."""
    found = set()
    for node in ast.walk(MODULES[module]):
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{module}: relative import"
            found.add(node.module)
            found.update(f"{node.module}.{alias.name}" for alias in node.names)
    return found


def test_all_rooms_are_looked_at():
    assert {"diffbot_control.law.lyapunov_law", "diffbot_bag.reader", "diffbot_sim.model.plant"} <= set(MODULES)
    assert len(MODULES) > 40
    nested = [path for floor in FLOORS for path in (ROOT / floor).glob("*/**/*.py")]
    assert not nested


@pytest.mark.parametrize("module", sorted(MODULES))
def test_imports_go_downwards_only(module):
    own = FLOORS.index(module.partition(".")[0])
    floors = {name.partition(".")[0] for name in imports_of(module)} & set(FLOORS)
    assert floors <= set(FLOORS[: own + 1])


@pytest.mark.parametrize("module", sorted(MODULES))
def test_nothing_imports_a_node(module):
    nodes = {name for name in MODULES if name.endswith("_node")}
    assert not imports_of(module) & nodes


@pytest.mark.parametrize("module", PURE)
def test_only_nodes_and_conversions_import_ros(module):
    names = imports_of(module)
    assert not {name.partition(".")[0] for name in names} & ROS
    # Nor by the back door.
    assert not {name for name in names if name in MODULES and knows_ros(name)}


@pytest.mark.parametrize("module", sorted(module for module in MODULES if module.startswith("diffbot_control.")))
def test_what_runs_on_the_robot_does_not_compile(module):
    assert not {name.partition(".")[0] for name in imports_of(module)} & {"numba", "llvmlite"}


@pytest.mark.parametrize(
    "module",
    ["laws", "navigation", "regions", "limits", "goal", "controller", "geometry", "kinematics", "supervisor"],
)
def test_the_law_knows_neither_time_nor_chance_nor_arrays(module):
    names = {name.partition(".")[0] for name in imports_of(f"diffbot_control.{module}")}
    assert names <= {"__future__", "math", "typing", "diffbot_control"}


def test_the_plant_does_not_use_the_filters_model():
    for module in ("plant", "sensors", "noise"):
        assert not {name for name in imports_of(f"diffbot_sim.{module}") if "ekf" in name or "kalman" in name}


def test_pure_modules_live_without_ros():
    # In an interpreter that has no ROS, as far as imports can see.
    program = f"""
import importlib, sys

class NoRos:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {ROS!r}:
            raise ImportError(f"{{name}}: there is no ROS here")

sys.meta_path.insert(0, NoRos())
for name in {PURE!r}:
    importlib.import_module(name)
found = {{name.partition(".")[0] for name in sys.modules}} & {ROS!r}
assert not found, found
"""
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=INSTALLED, capture_output=True, text=True, timeout=100, check=False
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("module", sorted(MODULES))
def test_everything_public_is_explained(module):
    tree = MODULES[module]
    assert ast.get_docstring(tree), module
    kinds = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)
    open_doors = [node for node in tree.body if isinstance(node, kinds) and not node.name.startswith("_")]
    for node in open_doors:
        assert ast.get_docstring(node), node.name
        for inner in node.body if isinstance(node, ast.ClassDef) else ():
            if isinstance(inner, kinds) and not inner.name.startswith("_"):
                assert ast.get_docstring(inner), f"{node.name}.{inner.name}"


@pytest.mark.parametrize("module", sorted(MODULES))
def test_input_is_not_checked_by_assert(module):
    # `python -O` would take such checks away.
    lines = [node.lineno for node in ast.walk(MODULES[module]) if isinstance(node, ast.Assert)]
    assert not lines
