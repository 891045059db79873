"""What others would install: an sdist with all that a build needs and no more, and its wheel in a clean environment."""

import email
import os
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from source_files import PACKAGES, PYTHONS, ROOT, source_tree

# A busy machine takes minutes for the first imports in a new environment.
pytestmark = [pytest.mark.install, pytest.mark.timeout(600)]

BESIDE_THE_SOURCE = {"PKG-INFO", "setup.cfg"}
"""What the build writes into the sdist, apart from its egg-info."""
NOT_BUILT_FROM = {"docs", "examples", "test", ".ci", ".github"}
MESSAGES = 5


def run(*command, status=0, cwd=None):
    """Run a program without what this environment may add; return its output, or its errors if it is to fail."""
    clean = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "AMENT", "ROS"))}
    command = [str(word) for word in command]
    done = subprocess.run(command, cwd=cwd, env=clean, capture_output=True, text=True, timeout=280, check=False)
    assert done.returncode == status, done.stdout + done.stderr
    return done.stderr if status else done.stdout


def build(kind, source, target):
    """Build an sdist or a wheel with the setuptools of this environment, fetching nothing."""
    program = f"from setuptools.build_meta import build_{kind} as build; print(build({str(target)!r}))"
    return target / run(sys.executable, "-c", program, cwd=source).splitlines()[-1]


@pytest.fixture(scope="module")
def sdist(tmp_path_factory):
    """Build from a copy of the source tree, in which files lie about as they do in one that is worked in."""
    folder = tmp_path_factory.mktemp("source")
    for path in source_tree():
        copy = folder / path.relative_to(ROOT)
        copy.parent.mkdir(parents=True, exist_ok=True)
        copy.write_bytes(path.read_bytes())
    for stray in ("out/demo/path.png", "diffbot_lab/notes.txt", "core.1234", "diffbot_sim/model/__pycache__/a.pyc"):
        (folder / stray).parent.mkdir(parents=True, exist_ok=True)
        (folder / stray).write_bytes(b"stray")
    return build("sdist", folder, tmp_path_factory.mktemp("sdist"))


@pytest.fixture(scope="module")
def wheel(sdist, tmp_path_factory):
    """Build from the sdist alone, as pip and pipx do."""
    folder = tmp_path_factory.mktemp("unpacked")
    with tarfile.open(sdist) as archive:
        archive.extractall(folder, filter="data")
    (source,) = folder.iterdir()
    return build("wheel", source, tmp_path_factory.mktemp("wheel"))


@pytest.fixture(scope="module")
def clean(wheel, tmp_path_factory):
    """Return the folder of the programs of an environment with nothing but the wheel and what it requires."""
    folder = tmp_path_factory.mktemp("clean") / "venv"
    run(sys.executable, "-m", "venv", "--without-pip", folder)
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--python", folder / "bin" / "python"]
    run(*pip, "install", "--quiet", "--no-compile", "--constraint", ROOT / "constraints.txt", wheel)
    return folder / "bin"


def test_sdist_holds_the_source_of_the_package_and_nothing_else(sdist):
    with tarfile.open(sdist) as archive:
        files = {Path(*Path(one.name).parts[1:]): archive.extractfile(one).read() for one in archive if one.isfile()}
    written = {path for path in files if path.parts[0].endswith(".egg-info") or str(path) in BESIDE_THE_SOURCE}
    tree = {path.relative_to(ROOT) for path in source_tree()}
    assert set(files) - written - tree == set()
    assert {path.parts[0] for path in files} & NOT_BUILT_FROM == set()
    assert {path for path in tree if path.parts[0] in PACKAGES} - set(files) == set()
    assert {Path(name) for name in ("setup.py", "pyproject.toml", "package.xml", "README.md", "LICENSE")} <= set(files)
    assert [path for path in set(files) - written if files[path] != (ROOT / path).read_bytes()] == []


def test_wheel_of_the_sdist_holds_every_module_and_file_of_the_package(wheel):
    with zipfile.ZipFile(wheel) as archive:
        files = {name for name in archive.namelist() if name.split("/")[0] in PACKAGES}
    assert files == {
        str(path.relative_to(ROOT)) for path in source_tree() if path.relative_to(ROOT).parts[0] in PACKAGES
    }


def test_metadata_describe_the_package_to_an_index(wheel):
    with zipfile.ZipFile(wheel) as archive:
        (name,) = [name for name in archive.namelist() if name.endswith(".dist-info/METADATA")]
        metadata = email.message_from_bytes(archive.read(name))
    assert metadata["Requires-Python"] == f">={PYTHONS[0]}"
    assert metadata["Description-Content-Type"] == "text/markdown"
    assert metadata.get_payload(decode=True).decode().strip() == (ROOT / "README.md").read_text().strip()
    named = {line.removeprefix("Programming Language :: Python :: ") for line in metadata.get_all("Classifier")}
    assert set(PYTHONS) <= named


def test_a_clean_environment_runs_what_needs_no_ros(clean, tmp_path):
    assert run(clean / "diffbot", "--help", cwd=tmp_path).startswith("usage: diffbot")
    assert run(clean / "python", ROOT / "examples" / "law_alone.py", cwd=tmp_path).count("\n") == 3

    types = get_typestore(Stores.ROS2_JAZZY)
    text = types.types["std_msgs/msg/String"]
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        topic = writer.add_connection("/chatter", text.__msgtype__, typestore=types)
        for second in range(MESSAGES):
            writer.write(topic, second * 10**9, types.serialize_cdr(text(data="hello"), text.__msgtype__))
    said = run(clean / "diffbot", "bag", "info", tmp_path / "bag").splitlines()
    assert [line for line in said if "/chatter" in line and str(MESSAGES) in line.split()]


@pytest.mark.parametrize("command", ["diffbot goal 1 2 0.5", "controller_node"])
def test_a_clean_environment_says_in_one_line_what_needs_ros(clean, command, tmp_path):
    name, *words = command.split()
    (line,) = run(clean / name, *words, status=1, cwd=tmp_path).splitlines()
    assert line.startswith(f"{name}: needs ROS 2 ")
    assert "extra jazzy" in line
