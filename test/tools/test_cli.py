"""The command diffbot: usage, help, completion, exit statuses, one-line errors."""

import os
import shlex
import subprocess
import sys
from argparse import Namespace
from pathlib import Path
from types import SimpleNamespace

import bag_commands
import bag_makers
import pytest
import view_bags

from diffbot_core.errors import DiffbotError
from diffbot_tools import cli
from diffbot_tools.arguments import OUTPUTS, check_outputs
from diffbot_tools.command_help import EXAMPLES
from diffbot_tools.goal_command import used_domains

WRONG = {
    "unknown command": ["dance"],
    "seed is no number": ["demo", "--seed", "abc"],
    "a goal without yaw": ["goal", "1", "2"],
    "timeout is no number": ["goal", "1", "2", "0", "--timeout", "soon"],
    "no span": ["bag", "trim", "a", "b"],
    "no time": ["bag", "trim", "a", "b", "--from", "yesterday"],
    "nothing to filter": ["bag", "filter", "a", "b"],
    "twice": ["bag", "merge", "a", "./a", "b"],
    "no size": ["bag", "split", "a", "b", "--size", "large"],
    "tiny size": ["bag", "split", "a", "b", "--size", "999"],
}


@pytest.mark.parametrize("arguments", WRONG.values(), ids=WRONG)
def test_wrong_usage_is_status_2_with_the_usage(arguments, capsys):
    with pytest.raises(SystemExit) as ended:
        cli.main(arguments)
    assert ended.value.code == 2
    written = capsys.readouterr()
    assert written.out == ""
    assert written.err.startswith("usage: diffbot")


def test_an_error_of_a_node_is_one_line_and_status_1(kept_signal_handlers, capfd):
    assert cli.main(["run", "controller", "--ros-args", "-p", "gamma:=-1.0"]) == 1
    assert capfd.readouterr().err == "error: /controller: gamma = -1.0: must be >= 1e-06 and <= 1000\n"


def test_replay_passes_bags_and_flags_on_as_parameters(kept_signal_handlers, monkeypatch):
    passed = []
    node = SimpleNamespace(main=lambda arguments: passed.extend(arguments) or 0)
    monkeypatch.setattr(cli.importlib, "import_module", lambda _name: node)
    assert cli.main(["replay", "one", "two", "three", "--as-fast-as-possible", "--seek", "2"]) == 0
    parameters = dict(text.split(":=") for text in passed[2::2])
    assert parameters == {"uri": '"one"', "bags": '["two", "three"]', "as_fast_as_possible": "true", "seek": "2.0"}


def test_negative_numbers_of_a_goal_are_positions_and_no_flags(kept_signal_handlers, monkeypatch):
    given = []
    monkeypatch.setattr("diffbot_tools.goal_command.run", lambda options: given.append(options) or 0)
    assert cli.main(["goal", "-1.5", "-2", "-0.5", "--timeout", "3", "--no-wait"]) == 0
    assert given[0].pose == (-1.5, -2.0, -0.5)
    assert (given[0].frame, given[0].wait, given[0].timeout) == ("map", False, 3.0)


@pytest.mark.parametrize("arguments", [["--controller", "a b"], ["--namespace", "1/"]])
def test_a_name_that_no_node_has_is_an_error_in_one_line(arguments, kept_signal_handlers, capsys):
    assert cli.main(["goal", "1", "2", "0", *arguments]) == 1
    written = capsys.readouterr().err
    assert written.startswith(("diffbot: namespace ", "diffbot: --controller "))
    assert written.count("\n") == 1


def test_the_command_line_and_the_launchers_of_nodes_start_without_heavy_libraries():
    """A goal is sent at once: scipy alone takes longer to load than the controller to answer."""
    rooms = ", ".join(f"diffbot_{room}.executables" for room in ("bag", "control", "sim", "tools"))
    program = f"import sys, diffbot_tools.cli, {rooms}; print(*{{m.partition('.')[0] for m in sys.modules}})"
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


READ = {"bag", "bags", "contract", "params", "folder", "file", "tuning", "runner"}
"""options with a path that is read"""


def test_outputs_of_every_command_are_checked_before_its_work(tmp_path, capsys):
    """A command whose option is new belongs into OUTPUTS of diffbot_tools.arguments, or into READ."""
    bag = bag_makers.write_folder(tmp_path / "bag", view_bags.irregular(0.5))
    before = {path: path.read_bytes() for path in bag.iterdir()}
    checked = set()
    for name, parser in bag_commands.leaves(cli._parser()):
        for action in (one for one in parser._actions if one.type is Path):
            assert action.dest in {*OUTPUTS, *READ}, f"{name} {action.dest}"
            if action.dest in OUTPUTS:
                checked.add(f"{name} {action.dest}")
                for path in (bag / "metadata.yaml", bag / "bag_0.mcap", bag / "new"):
                    options = Namespace(**{action.dest: path})
                    with pytest.raises(DiffbotError, match="is a bag"):
                        check_outputs(options)
    assert {"bag check write", "report out", "campaign out", "stability certify out", "watch record"} <= checked
    for path in before:
        assert cli.main(["report", str(bag), "-o", str(path)]) == 1
        assert capsys.readouterr().err == f"diffbot: cannot write to {path}: {bag} is a bag\n"
    assert {path: path.read_bytes() for path in bag.iterdir()} == before


def test_every_command_has_examples_that_its_own_parser_accepts_and_its_help_shows():
    parser = cli._parser()
    leaves = dict(bag_commands.leaves(parser))
    assert set(leaves) <= set(EXAMPLES) <= set(leaves) | {name.split()[0] for name in leaves}
    for name, leaf in leaves.items():
        for example in EXAMPLES[name]:
            assert f"\n  diffbot {example}\n" in leaf.format_help()
            options = parser.parse_args(shlex.split(example))
            assert example.startswith(name)
            assert callable(options.call)


def completed(line):
    """Return what the shell would offer, as the script of argcomplete asks for it."""
    environment = {**os.environ, "_ARGCOMPLETE": "1", "_ARGCOMPLETE_SUPPRESS_SPACE": "0", "COMP_LINE": line}
    environment |= {"COMP_POINT": str(len(line)), "_ARGCOMPLETE_IFS": "\n", "COMP_TYPE": "9"}
    command = f"exec 8>&1 9>/dev/null; exec {shlex.quote(sys.executable)} -m diffbot_tools.cli"
    done = subprocess.run(["bash", "-c", command], env=environment, capture_output=True, text=True, check=False)
    return {word.strip() for word in done.stdout.split("\n") if word.strip()}


def test_commands_flags_and_choices_are_completed():
    assert completed("diffbot ro") == {"robot"}
    assert completed("diffbot robot ") >= {"new", "check", "drive"}
    assert completed("diffbot robot new a.yaml --like turtle") == {"turtlebot3_burger", "turtlebot4"}
    assert "--restart-timeout" in completed("diffbot goal 1 2 0 --res")


def test_domains_are_those_of_the_discovery_ports():
    """DDSI-RTPS 9.6.1: multicast 7400 + 250 d, first participant 7400 + 250 d + 10; the second one's is no sign."""
    ports = (7400, 7400 + 250 * 42 + 10, 7400 + 250 * 7 + 12, 53, 60000)
    rows = [f"  {n}: 00000000:{port:04X} 00000000:0000 07" for n, port in enumerate(ports)]
    assert used_domains("\n".join(["  sl  local_address rem_address", *rows])) == [0, 42]
