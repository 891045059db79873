"""Installations: an sdist, its wheel in a clean environment, and a colcon workspace."""

import os
import shlex
import signal
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path
from typing import NamedTuple

import graph
import pytest
from bag_makers import BEGIN, STRING, string, write_rosbags
from source_files import PACKAGES, ROOT, source_tree

pytestmark = pytest.mark.install

COLCON = ("colcon-core", "colcon-python-setup-py", "colcon-ros")
NODES = ("controller_node", "ekf_node", "plant_node", "recorder_node", "replay_node")
NOT_BUILT_FROM = {"docs", "examples", "test", ".ci", ".github"}
PIP = (sys.executable, "-m", "pip", "--disable-pip-version-check")
PINNED = ("--quiet", "--constraint", ROOT / "constraints.txt")


class Installation(NamedTuple):
    source: str  # shell command that makes it usable
    prefix: Path
    root: Path  # folder with all its files


def run(*command, status=0, cwd=None, **environment):
    """Run a program without the variables of this environment; return its output, or its errors if it should fail."""
    clean = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "AMENT", "ROS"))}
    command = [str(word) for word in command]
    done = subprocess.run(
        command, cwd=cwd, env={**clean, **environment}, capture_output=True, text=True, timeout=600, check=False
    )
    assert done.returncode == status, shlex.join(command) + "\n" + done.stdout + done.stderr
    return done.stderr if status else done.stdout


def build(kind, source, target):
    """Build an sdist or a wheel with the setuptools of this environment, without downloads."""
    program = f"from setuptools.build_meta import build_{kind} as build; print(build({str(target)!r}))"
    return target / run(sys.executable, "-c", program, cwd=source).splitlines()[-1]


@pytest.fixture(scope="module")
def unpacked(tmp_path_factory):
    """Return the folder of an unpacked sdist, built from a source tree with stray files."""
    folder, target = (tmp_path_factory.mktemp(name) for name in ("source", "unpacked"))
    for path in source_tree():
        copy = folder / path.relative_to(ROOT)
        copy.parent.mkdir(parents=True, exist_ok=True)
        copy.write_bytes(path.read_bytes())
    for stray in ("out/demo/path.png", "diffbot_lab/notes.txt", "core.1234", "diffbot_sim/model/__pycache__/a.pyc"):
        (folder / stray).parent.mkdir(parents=True, exist_ok=True)
        (folder / stray).write_bytes(b"stray")
    with tarfile.open(build("sdist", folder, tmp_path_factory.mktemp("sdist"))) as archive:
        archive.extractall(target, filter="data")
    (source,) = target.iterdir()
    return source


@pytest.fixture(scope="module")
def wheel(unpacked, tmp_path_factory):
    """Build a wheel from the sdist alone, as pip does."""
    return build("wheel", unpacked, tmp_path_factory.mktemp("wheel"))


@pytest.fixture(scope="module")
def workspace(unpacked, tmp_path_factory):
    """Build a workspace from the sdist by colcon."""
    # The plug-ins of colcon must not be installed into this environment.
    folder, root = (tmp_path_factory.mktemp(name) for name in ("colcon", "workspace"))
    run(*PIP, "install", *PINNED, "--no-build-isolation", "--no-compile", "--target", folder, *COLCON)
    command = [sys.executable, folder / "bin" / "colcon", "build", "--base-paths", unpacked]
    run(*command, cwd=root, PYTHONPATH=str(folder), AMENT_PREFIX_PATH=sys.prefix)
    prefix = root / "install" / "diffbot"
    return Installation(f". {shlex.quote(str(prefix.parent / 'setup.sh'))}", prefix, root)


def in_shell(installation, program, *arguments):
    """Return a command that runs a program of an installation."""
    # exec: a signal must reach the program and not the shell.
    return ["sh", "-c", f"{installation.source} && exec {shlex.join([str(program), *arguments])}"]


def environment_of_wheels(folder):
    """Return the environment of a new shell in which only the prefix of this Python is sourced."""
    foreign = {"_ROS_WHEELS_BOOTSTRAP_COMPLETE", "LD_LIBRARY_PATH", "PYTHONPATH"}
    environment = {name: value for name, value in os.environ.items() if name not in foreign}
    path = os.pathsep.join([str(Path(sys.prefix, "bin")), os.environ["PATH"]])
    return {**environment, "PATH": path, "AMENT_PREFIX_PATH": sys.prefix, "ROS_LOG_DIR": str(folder)}


def test_sdist_and_wheel_contain_the_source_of_the_package_and_no_other_files(unpacked, wheel):
    tree = {path.relative_to(ROOT) for path in source_tree()}
    of_package = {path for path in tree if path.parts[0] in PACKAGES}
    files = {path.relative_to(unpacked) for path in unpacked.rglob("*") if path.is_file()}
    copied = files & tree
    # Files of the build of the wheel.
    made = {path for path in files if path.parts[0] == "build" or path.parts[0].endswith(".egg-info")}
    assert files - made - tree == {Path("PKG-INFO")}
    assert of_package | {Path("setup.py"), Path("package.xml"), Path("README.md"), Path("LICENSE")} <= copied
    assert {path.parts[0] for path in copied} & NOT_BUILT_FROM == set()
    changed = {path for path in copied if (unpacked / path).read_bytes() != (ROOT / path).read_bytes()}
    assert changed <= {Path("setup.cfg")}  # the build adds to it
    with zipfile.ZipFile(wheel) as archive:
        assert {Path(name) for name in archive.namelist() if name.split("/")[0] in PACKAGES} == of_package


def test_without_ros_bags_and_the_library_work_and_nodes_report_one_line(wheel, tmp_path):
    run(sys.executable, "-m", "venv", "--without-pip", tmp_path / "venv")
    programs = tmp_path / "venv" / "bin"
    run(*PIP, "--python", programs / "python", "install", *PINNED, "--no-compile", wheel)

    write_rosbags(tmp_path / "bag", [("/chatter", BEGIN + second, string("hello")) for second in range(5)], STRING)
    info = run(programs / "diffbot", "bag", "info", tmp_path / "bag", cwd=tmp_path).splitlines()
    assert [line for line in info if "/chatter" in line and "5" in line.split()]
    section = (ROOT / "README.md").read_text().split("## Use it as a library")[1].split("\n## ")[0]
    code = "".join(f"{line[4:]}\n" for line in section.splitlines() if line.startswith("    "))
    assert run(programs / "python", "-c", code, cwd=tmp_path).count("\n") == 2

    for name, *words in (["diffbot", "goal", "1", "2", "0.5"], ["controller_node"]):
        (line,) = run(programs / name, *words, status=1, cwd=tmp_path).splitlines()
        assert line.startswith(f"{name}: needs ROS 2 ")
        assert "extra jazzy" in line


def test_a_node_starts_from_the_folder_in_which_ros2_run_looks_and_ends_cleanly(workspace, tmp_path):
    command = in_shell(workspace, workspace.prefix / "lib" / "diffbot" / "plant_node")
    with graph.process(*command, cwd=tmp_path, env=environment_of_wheels(tmp_path)) as node:
        node.wait_for_output("[plant]: ready", 200.0)
        assert node.stop(signal.SIGINT) == 0


@pytest.mark.parametrize("made_by", ["pip", "colcon"])
def test_ros_finds_the_command_the_modules_and_the_shared_files(made_by, request, tmp_path):
    of_pip = Installation("true", Path(sys.prefix), Path(sys.prefix))
    installation = of_pip if made_by == "pip" else request.getfixturevalue("workspace")
    assert {path.name for path in (installation.prefix / "lib" / "diffbot").iterdir()} >= {*NODES, "diffbot"}

    def printed(*program):
        command, environment = in_shell(installation, *program), environment_of_wheels(tmp_path)
        return subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=True).stdout

    assert "usage: diffbot" in printed(installation.prefix / "lib" / "diffbot" / "diffbot", "--help")
    origin = printed(sys.executable, "-c", "import diffbot_control; print(diffbot_control.__file__)")
    assert Path(origin).is_relative_to(installation.root)
    share = installation.prefix / "share"
    assert (share / "ament_index" / "resource_index" / "packages" / "diffbot").is_file()
    for pattern in ("launch/*.launch.py", "config/*.yaml", "rviz/*.rviz", "urdf/*.urdf"):
        expected = {path.name for path in ROOT.glob(pattern)}
        assert expected
        assert {path.name for path in share.glob(f"diffbot/{pattern}")} == expected
