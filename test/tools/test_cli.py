"""The command diffbot: usage, exit statuses, one-line errors. The demonstration has a file of its own."""

import signal
import subprocess
import sys
from types import SimpleNamespace

import graph
import pytest

from diffbot_control.goals import goal_record
from diffbot_tools import cli
from diffbot_tools.goal_command import ENDS, INTERRUPTED, TIMED_OUT

DIFFBOT = (sys.executable, "-m", "diffbot_tools.cli")
WRONG = {
    "unknown command": ["dance"],
    "seed is no number": ["demo", "--seed", "abc"],
    "domain is too large": ["demo", "--domain", "233"],
    "a goal without yaw": ["goal", "1", "2"],
    "x is nan": ["goal", "nan", "2", "0"],
    "timeout is no number": ["goal", "1", "2", "0", "--timeout", "soon"],
    "timeout is zero": ["goal", "1", "2", "0", "--timeout", "0"],
}


def diffbot(*arguments):
    """Run the command to its end."""
    command = [*DIFFBOT, *map(str, arguments)]
    return subprocess.run(command, env=graph.environment(), capture_output=True, text=True, timeout=120, check=False)


@pytest.mark.parametrize("arguments", WRONG.values(), ids=WRONG)
def test_wrong_usage_is_status_2_with_the_usage(arguments, capsys):
    with pytest.raises(SystemExit) as ended:
        cli.main(arguments)
    assert ended.value.code == 2
    written = capsys.readouterr()
    assert written.out == ""
    assert written.err.startswith("usage: diffbot")


def test_an_error_of_a_node_is_one_line_and_status_1(tmp_path):
    file = tmp_path / "notes.mcap"
    file.write_text("no bag at all\n" * 10)
    ended = diffbot("replay", file)
    assert ended.returncode == 1
    assert len(ended.stderr.splitlines()) == 1, ended.stderr
    assert str(file) in ended.stderr


def test_replay_passes_bags_and_flags_on_as_parameters(kept_signal_handlers, monkeypatch):
    passed = []
    node = SimpleNamespace(main=lambda arguments: passed.extend(arguments) or 0)
    monkeypatch.setattr(cli.importlib, "import_module", lambda _name: node)
    assert cli.main(["replay", "one", "two", "three", "--as-fast-as-possible", "--seek", "2"]) == 0
    parameters = dict(text.split(":=") for text in passed[2::2])
    assert parameters == {
        "uri": '"one"',
        "bags": '["two", "three"]',
        "as_fast_as_possible": "true",
        "seek": "2.0",
    }


@pytest.mark.graph
def test_run_starts_a_node_with_its_ros_arguments_and_a_signal_ends_it():
    arguments = ("run", "controller", "--ros-args", "-r", "__ns:=/cli", "-p", "gamma:=2", "-p", "gama:=1.0")
    with graph.process(*DIFFBOT, *arguments) as process:
        process.wait_for_output("[cli.controller]: ready")
        assert process.output.count("unknown parameter '") == 1
        assert "unknown parameter 'gama' is ignored; did you mean 'gamma'?" in process.output
        assert process.stop(signal.SIGTERM) == 0
        assert "Traceback" not in process.output


@pytest.mark.graph
def test_run_returns_the_status_of_a_node_that_refuses_to_start():
    ended = diffbot("run", "ekf", "--ros-args", "-p", "wheel_radius:=0.0")
    assert ended.returncode == 1
    assert ended.stderr == "error: wheel_radius = 0.0: must be >= 0.001 and <= 10\n"


def test_negative_numbers_of_a_goal_are_positions_and_no_flags(kept_signal_handlers, monkeypatch):
    given = []
    monkeypatch.setattr("diffbot_tools.goal_command.run", lambda options: given.append(options) or 0)
    assert cli.main(["goal", "-1.5", "-2", "-0.5", "--timeout", "3", "--no-wait"]) == 0
    assert given[0].pose == (-1.5, -2.0, -0.5)
    assert (given[0].frame, given[0].wait, given[0].timeout) == ("map", False, 3.0)


def test_each_end_of_a_goal_has_a_status_of_its_own():
    assert set(goal_record.ENDS) < set(ENDS)
    statuses = [*ENDS.values(), TIMED_OUT, INTERRUPTED, 1, 2]
    assert len(set(statuses)) == len(statuses)
    assert ENDS[goal_record.REACHED] == 0


@pytest.mark.parametrize("arguments", [["--controller", "a b"], ["--namespace", "1/"]])
def test_a_name_that_no_node_has_is_an_error_in_one_line(arguments, kept_signal_handlers, capsys):
    assert cli.main(["goal", "1", "2", "0", *arguments]) == 1
    written = capsys.readouterr().err
    assert written.startswith(("diffbot: namespace ", "diffbot: --controller "))
    assert written.count("\n") == 1


def test_the_command_line_starts_without_heavy_libraries():
    """A goal is sent at once: scipy alone takes longer to load than the controller to answer."""
    program = "import sys, diffbot_tools.cli; print(*{m.partition('.')[0] for m in sys.modules})"
    loaded = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=True)
    heavy = {"scipy", "filterpy", "numpy", "matplotlib", "numba", "pandas", "rclpy"}
    assert heavy & set(loaded.stdout.split()) == set()


def test_demo_refuses_what_it_cannot_write_before_anything_starts(tmp_path, kept_signal_handlers, capsys, monkeypatch):
    def start(*_args, **_options):
        raise AssertionError("a node was started")

    monkeypatch.setattr("diffbot_tools.demo.processes.NodeProcesses.start", start)
    used = tmp_path / "used" / "bag" / "metadata.yaml"
    foreign = tmp_path / "foreign" / "bag" / "thesis.txt"
    odd = tmp_path / "odd" / "bag"
    for file in (used, foreign, odd):
        file.parent.mkdir(parents=True)
        file.write_text("mine")
    cases = {
        (tmp_path / "used",): "--overwrite",
        (tmp_path / "foreign",): "--overwrite",
        (tmp_path / "foreign", "--overwrite"): "is no bag",
        (tmp_path / "odd", "--overwrite"): "is no bag",
        (odd,): "cannot write to",
        ("/proc/nothing/here",): "cannot write to",
    }
    for arguments, words in cases.items():
        assert cli.main(["demo", "--out", *map(str, arguments)]) == 1
        written = capsys.readouterr().err
        assert words in written
        assert len(written.splitlines()) == 1
        assert written.startswith("diffbot: ")
    assert {file.read_text() for file in (used, foreign, odd)} == {"mine"}
