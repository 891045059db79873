"""A signal while a program still imports ends it silently, a node with status 0 and a command with 130."""

import signal
import sys
from pathlib import Path

import graph
import pytest

DIFFBOT_RUN = ("diffbot", "run", "controller")


def started(name, *arguments, folder):
    """Start a program of this environment; Python writes a line for each module once it is imported."""
    environment = graph.environment(PYTHONPROFILEIMPORTTIME="1")
    return graph.process(Path(sys.executable).parent / name, *arguments, env=environment, cwd=folder)


@pytest.mark.parametrize(
    ("command", "module", "number", "status"),
    [
        (("replay_node",), "rclpy", signal.SIGTERM, 0),
        # Before the command is known, it is one that was interrupted; then it is a node.
        (DIFFBOT_RUN, "diffbot_tools.run_command", signal.SIGTERM, 130),
    ],
)
def test_a_signal_during_the_imports_ends_a_program_silently(command, module, number, status, tmp_path):
    with started(*command, folder=tmp_path) as process:
        process.wait_for_output(f" {module}\n")
        assert process.stop(number) == status
        for word in ("Traceback", "KeyboardInterrupt", "Exception ignored"):
            assert word not in process.output


def test_a_signal_that_is_ignored_stays_ignored(tmp_path):
    """As for a process in the background of a shell script."""
    script = 'trap "" INT; exec "$0"', str(Path(sys.executable).with_name("controller_node"))
    with started("/bin/sh", "-c", *script, folder=tmp_path) as process:
        process.wait_for_output(" numpy\n")
        process.send(signal.SIGINT)
        process.wait_for_output("]: ready")
        assert process.stop(signal.SIGTERM) == 0
