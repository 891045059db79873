"""A signal while a program still imports ends it silently, a node with status 0 and a command with 130."""

import os
import random
import signal
import sys
from pathlib import Path

import graph
import pytest

EXECUTABLES = ("controller_node", "ekf_node", "robot_node", "plant_node", "recorder_node", "replay_node")
STARTS = 5


def started(command, folder):
    # Python then writes a line to stderr for each module, once it is imported.
    environment = {**os.environ, "PYTHONPROFILEIMPORTTIME": "1", "PYTHONUNBUFFERED": "1"}
    return graph.process(*command, env=environment, cwd=folder)


def imports(command, folder):
    """Return the modules that a node imports between the launcher and the beginning of its work, in their order."""
    with started(command, folder) as process:
        # A replay without a bag refuses to start, having imported everything.
        graph.wait_for(lambda: "ready" in process.output or "error:" in process.output, 30.0, "the end of the imports")
        lines = [line for line in process.output.splitlines() if line.startswith("import time:")]
        process.stop()
    names = [line.rpartition("|")[2].strip() for line in lines]
    first = max(index for index, name in enumerate(names) if name.endswith((".launcher", ".executables")))
    last = max(index for index, name in enumerate(names) if name.startswith("diffbot_"))
    return names[first + 1 : last]


def statuses(command, folder, seed):
    """Start a program several times, end it at a random one of its imports; return the exit statuses."""
    modules = imports(command, folder)
    assert len(modules) > 100
    moments = [0, 1, *random.Random(seed).sample(range(len(modules)), STARTS - 2)]
    found, late = [], 0
    for number, moment in enumerate(moments):
        with started(command, folder) as process:
            process.wait_for_output(f" {modules[moment]}\n", timeout=30.0)
            found.append(process.stop(signal.SIGTERM if number % 2 else signal.SIGINT, 5.0))
            late += "ready" in process.output or "error:" in process.output
            for word in ("Traceback", "KeyboardInterrupt", "Exception ignored"):
                assert word not in process.output, f"at the import of {modules[moment]}:\n{process.output}"
    assert late <= STARTS // 2
    return found


@pytest.mark.timeout(300)
@pytest.mark.parametrize("name", EXECUTABLES)
def test_signal_during_the_imports_ends_a_node_silently(name, tmp_path):
    first, second, *others = statuses([Path(sys.executable).with_name(name)], tmp_path, name)
    assert (first, second) == (0, 0)
    # The last ones may find a replay that has refused to start without a bag.
    assert set(others) <= ({0, 1} if name == "replay_node" else {0})


def test_the_same_for_a_module_run_by_python(tmp_path):
    command = [sys.executable, "-m", "diffbot_control.controller_node"]
    assert statuses(command, tmp_path, 1) == [0] * STARTS


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize(("module", "status"), [("diffbot_lab.run_command", 130), ("rclpy", 0)])
def test_the_same_for_the_command_line(number, module, status, tmp_path):
    """Before the command is known, it is one that was interrupted; then it is a node."""
    with started([Path(sys.executable).with_name("diffbot"), "run", "controller"], tmp_path) as process:
        process.wait_for_output(f" {module}\n", timeout=30.0)
        assert process.stop(number, 5.0) == status
        assert "Traceback" not in process.output


def test_a_signal_that_is_ignored_stays_ignored(tmp_path):
    """As for a process in the background of a shell script."""
    command = ["sh", "-c", 'trap "" INT; exec "$0"', str(Path(sys.executable).with_name("controller_node"))]
    with started(command, tmp_path) as process:
        process.wait_for_output(" numpy\n", timeout=30.0)
        process.send(signal.SIGINT)
        process.wait_for_output("]: ready", timeout=30.0)
        assert process.stop(signal.SIGTERM, 5.0) == 0
