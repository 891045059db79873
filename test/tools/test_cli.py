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
from diffbot_tools.arguments import OUTPUTS, check_outputs
from diffbot_tools.drive import used_domains

WRONG = {
    "a goal without yaw": ["goal", "1", "2"],
    "degrees for radians": ["goal", "1", "1", "90"],
    "no angle": ["dock", "1", "1", "--timeout", "north"],
    "unknown command": ["dance"],
    "no time": ["bag", "trim", "a", "b", "--from", "yesterday"],
    "a merge of one bag": ["bag", "merge", "a", "b"],
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
    assert cli.main(["run", "controller", "--with", "plant", "--ros-args", "-p", "sigma_known:=-1.0"]) == 1
    assert capfd.readouterr().err == "error: /controller: sigma_known = -1.0: must be >= 0.0001 and <= 10\n"


def test_replay_passes_bags_and_flags_on_as_parameters(kept_signal_handlers, monkeypatch):
    passed = []
    node = SimpleNamespace(main=lambda arguments: passed.extend(arguments) or 0)
    monkeypatch.setattr(cli.importlib, "import_module", lambda _name: node)
    assert cli.main(["replay", "one", "two", "three", "--as-fast-as-possible", "--seek", "2"]) == 0
    parameters = dict(text.split(":=") for text in passed[2::2])
    assert parameters == {"uri": '"one"', "bags": '["two", "three"]', "as_fast_as_possible": "true", "seek": "2.0"}


def test_a_name_that_no_node_has_is_an_error_in_one_line(kept_signal_handlers, capsys):
    assert cli.main(["goal", "-1", "-2", "0", "--controller", "a b"]) == 1
    written = capsys.readouterr().err
    assert written.startswith("diffbot: namespace '', controller 'a b': ")
    assert written.count("\n") == 1


def test_the_command_line_and_the_launchers_of_nodes_start_without_heavy_libraries():
    """A goal is sent at once: scipy alone takes longer to load than the controller to answer."""
    modules = "sys, diffbot_tools.cli, diffbot.executables"
    program = f"import {modules}; print(*{{m.partition('.')[0] for m in sys.modules}})"
    loaded = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=True)
    heavy = {"scipy", "filterpy", "numpy", "matplotlib", "numba", "pandas", "rclpy"}
    assert heavy & set(loaded.stdout.split()) == set()


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
    assert {"report out", "campaign out", "stability certify out", "watch record"} <= checked
    for path in before:
        assert cli.main(["report", str(bag), "-o", str(path)]) == 1
        assert capsys.readouterr().err == f"diffbot: cannot write to {path}: {bag} is a bag\n"
    assert {path: path.read_bytes() for path in bag.iterdir()} == before


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


def test_a_reader_that_leaves_ends_the_command_without_a_traceback():
    command = f"{shlex.quote(sys.executable)} -m diffbot_tools.cli robot drive turtlebot4 --goals 1 --out /dev/full"
    script = f"set -o pipefail; {command} | head -n 0; echo $?"
    done = subprocess.run(["bash", "-c", script], capture_output=True, text=True, check=False)
    assert "Traceback" not in done.stderr
    assert "BrokenPipe" not in done.stderr
