"""The command ``diffbot goal``, without ROS: what it passes on, its exit statuses, what it loads."""

import ast
import subprocess
import sys

import pytest

from diffbot_control.law import goal_record
from diffbot_lab import cli
from diffbot_lab.goal_command import ENDS, INTERRUPTED, TIMED_OUT


def test_negative_numbers_are_positions_and_no_flags(kept_signal_handlers, monkeypatch):
    given = []
    monkeypatch.setattr("diffbot_lab.goal_command.run", lambda options: given.append(options) or 0)
    assert cli.main(["goal", "-1.5", "-2", "-0.5", "--timeout", "3", "--no-wait"]) == 0
    assert given[0].pose == (-1.5, -2.0, -0.5)
    assert (given[0].frame, given[0].wait, given[0].timeout) == ("map", False, 3.0)


def test_each_end_has_a_status_of_its_own():
    assert set(goal_record.ENDS) < set(ENDS)
    statuses = [*ENDS.values(), TIMED_OUT, INTERRUPTED, 1, 2]
    assert len(set(statuses)) == len(statuses)
    assert ENDS[goal_record.REACHED] == 0


@pytest.mark.parametrize("arguments", [["--controller", "a b"], ["--namespace", "1/"]])
def test_a_name_that_no_node_has_is_an_error_in_one_line(arguments, kept_signal_handlers, capsys):
    assert cli.main(["goal", "1", "2", "0", *arguments]) == 1
    written = capsys.readouterr()
    assert written.out == ""
    assert written.err.startswith(("diffbot: namespace ", "diffbot: --controller "))
    assert written.err.count("\n") == 1


def test_the_command_line_starts_without_heavy_libraries():
    """A goal is sent at once: scipy alone takes longer to load than the controller to answer."""
    program = "import sys, diffbot_lab.cli; print(sorted({m.partition('.')[0] for m in sys.modules}))"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=True)
    loaded = set(ast.literal_eval(done.stdout))
    assert loaded & {"scipy", "filterpy", "numpy", "matplotlib", "numba", "pandas", "rclpy"} == set()
