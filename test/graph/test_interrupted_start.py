"""A signal while a node still imports ends it silently, with the status of a signal."""

import os
import random
import signal
import sys
from pathlib import Path

import graph
import pytest

EXECUTABLES = ("controller_node", "ekf_node", "robot_node", "plant_node", "recorder_node", "replay_node")
STARTS = 10


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
    """Start a node ten times, end it at a random one of its imports; return the exit statuses."""
    modules = imports(command, folder)
    assert len(modules) > 100
    moments = [0, 1, *random.Random(seed).sample(range(len(modules)), STARTS - 2)]
    found = []
    for number, moment in enumerate(moments):
        with started(command, folder) as process:
            process.wait_for_output(f" {modules[moment]}\n", timeout=30.0)
            found.append(process.stop(signal.SIGTERM if number == 1 else signal.SIGINT))
            for word in ("Traceback", "KeyboardInterrupt", "Exception ignored"):
                assert word not in process.output, f"at the import of {modules[moment]}:\n{process.output}"
    return found


@pytest.mark.timeout(300)
@pytest.mark.parametrize("name", EXECUTABLES)
def test_signal_during_the_imports_ends_a_node_silently(name, tmp_path):
    first, second, *others = statuses([Path(sys.executable).with_name(name)], tmp_path, name)
    assert (first, second) == (-signal.SIGINT, -signal.SIGTERM)
    # The last ones may find a node that is up; it ends well then, or with 1 for want of a bag to replay.
    assert set(others) <= {-signal.SIGINT, 0, 1}
    assert others.count(-signal.SIGINT) >= STARTS // 2


def test_the_same_for_a_module_run_by_python(tmp_path):
    command = [sys.executable, "-m", "diffbot_control.controller_node"]
    first, *_ = statuses(command, tmp_path, 1)
    assert first == -signal.SIGINT
