"""What import-linter (`make lint`) does not see of the rooms: what is loaded when a module is imported."""

import json
import subprocess
import sys
from pathlib import Path

import diffbot_core

ROOT = Path(__file__).resolve().parents[2]
INSTALLED = Path(diffbot_core.__file__).resolve().parent.parent
MODULES = [
    ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
    for path in sorted(ROOT.glob("diffbot_*/**/*.py"))
]
ROS = {
    "action_msgs", "ament_index_python", "builtin_interfaces", "diagnostic_msgs", "geometry_msgs", "launch",
    "launch_ros", "lifecycle_msgs", "nav_msgs", "rcl_interfaces", "rclpy", "rosbag2_py", "rosgraph_msgs",
    "rosidl_runtime_py", "rpyutils", "sensor_msgs", "std_msgs", "std_srvs", "tf2_msgs", "tf2_ros",
}  # fmt: skip


def uses_ros(module):
    """Return whether this module is one of the places of ROS: rooms named ``ros``, nodes, the conversions of bags."""
    _, *rooms = module.split(".")
    return "ros" in rooms or module.endswith("_node") or module == "diffbot_bag.ros.conversions"


def interpret(program):
    """Run a program in an interpreter of its own; return the JSON that it prints."""
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, cwd=INSTALLED, capture_output=True, text=True, timeout=200, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


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
