"""The end of a process: silent by a signal during its imports, and forced if the middleware does not let it end."""

import signal
import sys
import time
from pathlib import Path

import graph
import pytest

from diffbot_core.ros import run

DIFFBOT_RUN = ("diffbot", "run", "controller", "--with", "plant")
HOLD = """
import sys, time

class Hold:
    def find_spec(self, name, path=None, target=None):
        if name == {module!r}:
            print("at", name, flush=True)
            time.sleep(3600.0)

sys.meta_path.insert(0, Hold())
"""
"""A ``sitecustomize``, which Python runs first. The process waits at the import of a module until a signal ends it."""


def started(name, *arguments, folder, **environment):
    """Start a program of this environment in an empty folder."""
    command = Path(sys.executable).parent / name, *arguments
    return graph.process(*command, env=graph.environment(**environment), cwd=folder)


@pytest.mark.parametrize(
    ("command", "module", "number", "status"),
    [
        # Until the command is known, it ends as an interrupted command; then as a node.
        (DIFFBOT_RUN, "diffbot_tools.run_command", signal.SIGTERM, 130),
        (DIFFBOT_RUN, "rclpy", signal.SIGINT, 0),
    ],
)
def test_a_signal_during_the_imports_ends_a_program_silently(command, module, number, status, tmp_path):
    hold, empty = tmp_path / "hold", tmp_path / "empty"
    for folder in (hold, empty):
        folder.mkdir()
    (hold / "sitecustomize.py").write_text(HOLD.format(module=module))
    path = f"{hold}:{graph.environment()['PYTHONPATH']}"
    with started(*command, folder=empty, PYTHONPATH=path) as process:
        process.wait_for_output(f"at {module}\n")
        assert process.stop(number) == status
        assert process.output == f"at {module}\n"


def test_a_signal_that_is_ignored_stays_ignored(tmp_path):
    """A shell script starts its background processes so."""
    script = 'trap "" INT; exec "$0"', str(Path(sys.executable).with_name("controller_node"))
    # Python then writes a line for each module once it is imported.
    with started("/bin/sh", "-c", *script, folder=tmp_path, PYTHONPROFILEIMPORTTIME="1") as process:
        process.wait_for_output(" numpy\n")
        process.send(signal.SIGINT)
        process.wait_for_output("]: ready")
        assert process.stop(signal.SIGTERM) == 0


STUCK = """
import ctypes
from rclpy.executors import SingleThreadedExecutor
from diffbot_core.shared_parameters import FaultConfig
from diffbot_core.ros.node import DiffbotNode
from diffbot_core.ros import run

class Node(DiffbotNode):
    def __init__(self):
        super().__init__("stuck", FaultConfig)

    def before_shutdown(self):
        print("robot stands", flush=True)

class Executor(SingleThreadedExecutor):
    pass

def hang(_self):
    ctypes.PyDLL(None).pause()

{method} = hang
run.make_executor = Executor
raise SystemExit(run.run(Node))
"""


@pytest.mark.parametrize("method", ["Node.destroy_node", "Executor.__del__"])
def test_a_node_that_the_middleware_does_not_let_end_is_ended_after_its_shutdown(method):
    """Fast DDS destroys the participant together with the node, or with the executor if it has the last handle."""
    with graph.process(sys.executable, "-c", STUCK.format(method=method)) as process:
        process.wait_for_output("ready")
        assert process.stop() == 0
        assert "robot stands" in process.output


class Unacknowledged:
    """A publisher whose readers never acknowledge, and its node."""

    def __init__(self, events):
        self.events, self.publishers, self.exit_code = events, [self], None

    def wait_for_all_acked(self, timeout):
        time.sleep(timeout.nanoseconds * 1e-9)
        self.events.append("waited")

    def destroy_node(self):
        self.events.append("destroyed")


def test_nodes_wait_for_their_readers_for_a_bounded_time_in_total_before_they_are_destroyed(monkeypatch):
    events, began = [], time.monotonic()
    monkeypatch.setattr(run.rclpy, "try_shutdown", lambda: events.append("shut down"))
    monkeypatch.setattr(run, "READERS_TIMEOUT", 0.3)
    run._destroy([Unacknowledged(events), Unacknowledged(events)], False)
    assert events == ["waited", "waited", "destroyed", "destroyed", "shut down"]
    assert 0.3 <= time.monotonic() - began < 3.0
