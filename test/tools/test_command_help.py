"""Examples and completion of the command line, and the domains that a goal looks for."""

import os
import shlex
import subprocess
import sys

import bag_commands

from diffbot_tools import cli
from diffbot_tools.command_help import EXAMPLES
from diffbot_tools.goal_command import used_domains


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
