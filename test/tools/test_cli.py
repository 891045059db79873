"""The command diffbot: usage, completion, exit statuses, one-line errors."""

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
from diffbot_tools.arguments import OUTPUTS, check_paths
from diffbot_tools.drive import used_domains


@pytest.mark.parametrize(
    "arguments", [["dance"], ["goal", "1", "2"], ["dock", "--timeout", "soon"], ["bag", "merge", "a", "b"]]
)
def test_wrong_usage_is_status_2_with_the_usage(arguments, capsys):
    with pytest.raises(SystemExit) as ended:
        cli.main(arguments)
    assert ended.value.code == 2
    written = capsys.readouterr()
    assert written.out == ""
    assert written.err.startswith("usage: diffbot")


def test_replay_gets_bags_and_flags_as_parameters(kept_signal_handlers, monkeypatch):
    passed = []
    node = SimpleNamespace(main=lambda arguments: passed.extend(arguments) or 0)
    monkeypatch.setattr(cli.importlib, "import_module", lambda _name: node)
    assert cli.main(["replay", "one", "two", "three", "--as-fast-as-possible", "--seek", "2"]) == 0
    parameters = dict(text.split(":=") for text in passed[2::2])
    assert parameters == {"uri": '"one"', "bags": '["two", "three"]', "as_fast_as_possible": "true", "seek": "2.0"}


def test_an_invalid_name_of_a_node_is_an_error_in_one_line(kept_signal_handlers, capsys):
    assert cli.main(["goal", "-1", "-2", "0", "--controller", "a b"]) == 1
    written = capsys.readouterr().err
    assert written.startswith("diffbot: namespace '', controller 'a b': ")
    assert written.count("\n") == 1


def test_the_command_line_and_the_executables_start_without_heavy_libraries():
    """Importing scipy alone takes longer than a controller needs to answer a goal."""
    modules = "sys, diffbot_tools.cli, diffbot.executables"
    program = f"import {modules}; print(*{{m.partition('.')[0] for m in sys.modules}})"
    loaded = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=True)
    heavy = {"scipy", "filterpy", "numpy", "matplotlib", "numba", "pandas", "rclpy"}
    assert heavy & set(loaded.stdout.split()) == set()


READ = {"bag", "bags", "contract", "params", "folder", "file", "tuning", "runner"}
"""Options with a path that is read."""


def test_no_command_overwrites_a_bag(tmp_path, capsys):
    """Every option with a path must be in OUTPUTS of diffbot_tools.arguments, or in READ."""
    bag = bag_makers.write_folder(tmp_path / "bag", view_bags.irregular(0.5))
    path, checked = bag / "metadata.yaml", set()
    before = path.read_bytes()
    for name, parser in bag_commands.leaves(cli._parser()):
        for action in (one for one in parser._actions if one.type is Path):
            assert action.dest in {*OUTPUTS, *READ}, f"{name} {action.dest}"
            if action.dest in OUTPUTS:
                checked.add(f"{name} {action.dest}")
                with pytest.raises(DiffbotError, match="is a bag"):
                    check_paths(Namespace(**{action.dest: path}))
    assert {"report out", "campaign out", "stability certify out", "watch record"} <= checked
    assert cli.main(["report", str(bag), "-o", str(path)]) == 1
    assert capsys.readouterr().err == f"diffbot: cannot write to {path}: {bag} is a bag\n"
    assert path.read_bytes() == before


def test_the_home_folder_is_expanded_in_every_path(tmp_path, monkeypatch, capsys):
    """The shell does not expand --out=~/file, and an unknown user is not an internal error."""
    monkeypatch.setenv("HOME", str(tmp_path))
    options = Namespace(out=Path("~/new"), bags=[Path("~/a"), Path("b")], name="~/c")
    check_paths(options)
    assert vars(options) == {"out": tmp_path / "new", "bags": [tmp_path / "a", Path("b")], "name": "~/c"}
    for command in (["report", "~no-such-user/bag"], ["robot", "check", "~no-such-user/robot.yaml"]):
        assert cli.main(command) == 1
        assert "~no-such-user/" in capsys.readouterr().err


def completed(line):
    """Return the completions of a command line, requested as the shell script of argcomplete does."""
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


def test_open_discovery_ports_show_the_domains_in_use():
    """DDSI-RTPS 9.6.1: multicast 7400 + 250 d, first participant 7400 + 250 d + 10; other ports do not count."""
    ports = (7400, 7400 + 250 * 42 + 10, 7400 + 250 * 7 + 12, 53, 60000)
    rows = [f"  {n}: 00000000:{port:04X} 00000000:0000 07" for n, port in enumerate(ports)]
    assert used_domains("\n".join(["  sl  local_address rem_address", *rows])) == [0, 42]


def test_a_closed_pipe_ends_the_command_without_a_traceback():
    command = f"{shlex.quote(sys.executable)} -m diffbot_tools.cli robot drive turtlebot4 --goals 1 --out /dev/full"
    script = f"set -o pipefail; {command} | head -n 0; echo $?"
    done = subprocess.run(["bash", "-c", script], capture_output=True, text=True, check=False)
    assert "Traceback" not in done.stderr
    assert "BrokenPipe" not in done.stderr
