"""Each executable starts and ends well where `ros2 run` looks, after colcon and after pip."""

import os
import shlex
import shutil
import signal
import subprocess
import sys
import time
import uuid
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import pytest
import rclpy
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

ROOT = Path(__file__).resolve().parents[2]
COLCON = ("colcon-core", "colcon-python-setup-py", "colcon-ros")
NODES = ("controller_node", "ekf_node", "plant_node", "recorder_node", "replay_node")
INSTALLATIONS = ("pip", "colcon", "colcon --symlink-install")

# The first test of a worker also installs colcon and builds.
pytestmark = [pytest.mark.install, pytest.mark.timeout(600)]


class Installation(NamedTuple):
    source: str  # the line of shell that makes it usable
    prefix: Path
    root: Path  # everything that belongs to it


def clean_environment(log_dir):
    """Return the environment of a fresh shell with only this Python's prefix sourced."""
    # What another environment of wheels leaves behind would make this one load foreign libraries.
    foreign = {"_ROS_WHEELS_BOOTSTRAP_COMPLETE", "LD_LIBRARY_PATH", "PYTHONPATH"}
    environment = {name: value for name, value in os.environ.items() if name not in foreign}
    environment["PATH"] = os.pathsep.join([str(Path(sys.prefix, "bin")), os.environ["PATH"]])
    environment["AMENT_PREFIX_PATH"] = sys.prefix
    environment["ROS_LOG_DIR"] = str(log_dir)
    return environment


def run(command, **options):
    result = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False, **options)
    assert result.returncode == 0, f"{shlex.join(map(str, command))}\n{result.stdout}{result.stderr}"
    return result.stdout


@pytest.fixture(scope="module")
def colcon(tmp_path_factory):
    """Install colcon into a folder of its own: its plug-ins must not enter the environment."""
    folder = tmp_path_factory.mktemp("colcon")
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "install", "--quiet"]
    constraints = ["--no-build-isolation", "--constraint", ROOT / "constraints.txt"]
    run([*pip, *constraints, "--target", folder, *COLCON], env=clean_environment(folder))
    return folder


@pytest.fixture(scope="module", params=INSTALLATIONS)
def installation(request, tmp_path_factory):
    if request.param == "pip":
        return Installation("true", Path(sys.prefix), Path(sys.prefix))
    workspace = tmp_path_factory.mktemp("workspace")
    built = shutil.ignore_patterns(".*", "build", "install", "log", "out", "__pycache__", "*.egg-info")
    shutil.copytree(ROOT, workspace / "src" / "diffbot", ignore=built)
    folder = request.getfixturevalue("colcon")
    environment = {**clean_environment(workspace), "PYTHONPATH": str(folder)}
    build = [sys.executable, folder / "bin" / "colcon", "build", *request.param.split()[1:]]
    run(build, cwd=workspace, env=environment)
    prefix = workspace / "install" / "diffbot"
    return Installation(f". {shlex.quote(str(prefix.parent / 'setup.sh'))}", prefix, workspace)


def in_shell(installation, program, *arguments):
    # exec, as a signal must reach the program and not the shell.
    return ["sh", "-c", f"{installation.source} && exec {shlex.join([str(program), *arguments])}"]


def wait_for(condition, what, seconds=60):
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, f"waited {seconds} s for {what}"
        time.sleep(0.05)


@contextmanager
def running(command, folder):
    """Run a program in this folder; give it and its log. It never outlives the test."""
    log = folder / "program.log"
    with log.open("w") as output:
        process = subprocess.Popen(
            command,
            stdout=output,
            stderr=subprocess.STDOUT,
            cwd=folder,
            env=clean_environment(folder),
        )
        try:
            yield process, log
        finally:
            process.kill()
            process.wait()


@pytest.fixture
def graph():
    """Return a function that lists the names of the nodes in the graph."""
    context = rclpy.Context()
    rclpy.init(context=context)
    node = rclpy.create_node("observer", context=context)
    yield node.get_node_names
    node.destroy_node()
    rclpy.shutdown(context=context)


def write_bag(path):
    """Write a bag of two messages an hour apart, so that playing it does not end by itself."""
    types = get_typestore(Stores.ROS2_JAZZY)
    text = types.types["std_msgs/msg/String"]
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        topic = writer.add_connection("/chatter", text.__msgtype__, typestore=types)
        for second in (1, 3601):
            data = types.serialize_cdr(text(data="hello"), text.__msgtype__)
            writer.write(topic, second * 10**9, data)


@pytest.mark.parametrize("name", NODES)
def test_node_comes_up_and_ends_cleanly(installation, name, graph, tmp_path):
    # Of its own for each run: the graph remembers a node that died for a while.
    alias = f"{name}_{uuid.uuid4().hex}"
    program = installation.prefix / "lib" / "diffbot" / name
    arguments = ["--ros-args", "-r", f"__node:={alias}"]
    if name == "replay_node":
        write_bag(tmp_path / "bag")
        arguments += ["-p", f"uri:={tmp_path / 'bag'}"]
    command = in_shell(installation, program, *arguments)
    with running(command, tmp_path) as (process, log):
        wait_for(lambda: alias in graph() or process.poll() is not None, f"{alias} in the graph")
        assert process.poll() is None, log.read_text()
        process.send_signal(signal.SIGINT)
        wait_for(lambda: process.poll() is not None, f"the end of {name}")
        assert process.returncode == 0, log.read_text()


def test_command_is_where_ros2_run_looks(installation, tmp_path):
    command = in_shell(installation, installation.prefix / "lib" / "diffbot" / "diffbot", "--help")
    assert "usage: diffbot" in run(command, cwd=tmp_path, env=clean_environment(tmp_path))


def test_sourced_workspace_runs_its_own_modules(installation, tmp_path):
    code = "import diffbot_control; print(diffbot_control.__file__)"
    command = in_shell(installation, sys.executable, "-c", code)
    origin = run(command, cwd=tmp_path, env=clean_environment(tmp_path)).strip()
    assert Path(origin).is_relative_to(installation.root)


def test_ros_finds_package_launch_and_configuration(installation):
    share = installation.prefix / "share"
    assert (share / "ament_index" / "resource_index" / "packages" / "diffbot").is_file()
    for pattern in ("launch/*.launch.py", "config/*.yaml", "rviz/*.rviz", "urdf/*.urdf"):
        expected = {path.name for path in ROOT.glob(pattern)}
        assert expected
        assert {path.name for path in share.glob(f"diffbot/{pattern}")} == expected
