"""The command diffbot: usage, exit statuses, one-line errors. The demonstration has a file of its own."""

import importlib
import signal
import subprocess
import sys
from types import SimpleNamespace

import graph
import pytest

from diffbot_lab import cli

DIFFBOT = (sys.executable, "-m", "diffbot_lab.cli")


def diffbot(*arguments):
    """Run the command to its end."""
    command = [*DIFFBOT, *map(str, arguments)]
    return subprocess.run(command, env=graph.environment(), capture_output=True, text=True, timeout=60.0, check=False)


WRONG = {
    "no command": [],
    "unknown command": ["dance"],
    "unknown flag": ["demo", "--fast"],
    "seed is no number": ["demo", "--seed", "abc"],
    "seed is negative": ["demo", "--seed", "-1"],
    "seed is too large": ["demo", "--seed", str(2**63)],
    "domain is negative": ["demo", "--domain", "-1"],
    "domain is too large": ["demo", "--domain", "233"],
    "flag without value": ["demo", "--out"],
    "unknown node": ["run", "coffee"],
    "no node": ["run"],
    "unknown node beside another": ["run", "robot", "--with", "coffee"],
    "argument of no node": ["run", "plant", "now"],
    "no bag": ["replay"],
    "rate is no number": ["replay", "somewhere", "--rate", "fast"],
}


@pytest.mark.parametrize("arguments", WRONG.values(), ids=WRONG)
def test_wrong_usage_is_status_2_with_the_usage(arguments, capsys):
    with pytest.raises(SystemExit) as ended:
        cli.main(arguments)
    assert ended.value.code == 2
    written = capsys.readouterr()
    assert written.out == ""
    assert written.err.startswith("usage: diffbot")
    assert "Traceback" not in written.err


@pytest.mark.parametrize("arguments", [["--help"], ["demo", "--help"], ["run", "--help"], ["replay", "--help"]])
def test_help_is_status_0_and_says_what_the_default_is(arguments, capsys):
    with pytest.raises(SystemExit) as ended:
        cli.main(arguments)
    assert ended.value.code == 0
    written = capsys.readouterr().out
    assert written.startswith("usage: diffbot")
    if arguments[0] == "demo":
        assert "--seed" in written
        assert "default: 1" in written


def test_process_ends_with_the_status_of_main():
    ended = diffbot("demo", "--seed", "x")
    assert ended.returncode == 2
    assert "Traceback" not in ended.stderr


BAD_REPLAYS = {
    "missing": (["/nowhere/at/all"], "/nowhere/at/all"),
    "rate of zero": (["/nowhere", "--rate", "0"], "rate = 0.0: must be"),
    "not finite": (["/nowhere", "--start-offset", "nan"], "start_offset = nan: must be"),
    "remapping": (["/nowhere", "--remap", "odom"], "odom"),
}


@pytest.mark.parametrize(("arguments", "words"), BAD_REPLAYS.values(), ids=BAD_REPLAYS)
def test_replay_refuses_in_one_line(arguments, words):
    ended = diffbot("replay", *arguments)
    assert ended.returncode == 1
    assert len(ended.stderr.splitlines()) == 1, ended.stderr
    assert words in ended.stderr


def test_replay_of_a_file_that_is_no_bag_is_one_line(tmp_path):
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


def test_every_node_of_the_command_exists(kept_signal_handlers):
    assert set(cli.NODES) == {"plant", "ekf", "controller", "robot", "recorder", "replay"}
    for entry in cli.NODES.values():
        assert callable(getattr(importlib.import_module(entry.module), entry.factory))


def test_demo_refuses_what_it_cannot_write_before_anything_starts(tmp_path, kept_signal_handlers, capsys, monkeypatch):
    def start(*_args, **_options):
        raise AssertionError("a node was started")

    monkeypatch.setattr("diffbot_lab.demo.processes.NodeProcesses.start", start)
    used = tmp_path / "used"
    (used / "bag").mkdir(parents=True)
    (used / "bag" / "metadata.yaml").write_text("mine")
    foreign = tmp_path / "foreign"
    (foreign / "bag").mkdir(parents=True)
    (foreign / "bag" / "thesis.txt").write_text("mine")
    odd = tmp_path / "odd"
    odd.mkdir()
    (odd / "bag").write_text("mine")
    file = tmp_path / "file"
    file.write_text("mine")
    cases = {
        ("--out", used): "--overwrite",
        ("--out", foreign): "--overwrite",
        ("--out", foreign, "--overwrite"): "is no bag",
        ("--out", odd): "--overwrite",
        ("--out", odd, "--overwrite"): "is no bag",
        ("--out", file): "cannot write to",
        ("--out", file / "below"): "cannot write to",
        ("--out", "/proc/nothing/here"): "cannot write to",
        ("--out", tmp_path / ("x" * 300)): "cannot write to",
    }
    for arguments, words in cases.items():
        assert cli.main(["demo", *map(str, arguments)]) == 1
        written = capsys.readouterr()
        assert words in written.err
        assert len(written.err.splitlines()) == 1
        assert written.err.startswith("diffbot: ")
    assert (used / "bag" / "metadata.yaml").read_text() == "mine"
    assert (foreign / "bag" / "thesis.txt").read_text() == "mine"
    assert (odd / "bag").read_text() == "mine"
