"""Runs every command that reads a bag, with suitable arguments, in this process."""

import argparse
import contextlib
import functools
import io
import traceback
from unittest import mock

import view_bags
from bag_makers import BEGIN, write_folder

from diffbot_tools import cli

PARAMETERS = "/ekf:\n  ros__parameters:\n    wheel_radius: 0.1\n    wheel_separation: 0.4\n"
CONTRACT = "version: 1\nbag: {max_lost: 0}\ntopics: {/odom: {min_rate: 1.0, max_gap: 1.0, stamped: true}}\n"
ARGUMENTS = {
    "bag info": ["{bag}"],
    "bag check": ["{bag}", "{given}/contract.yaml"],
    "bag repair": ["{bag}", "{out}"],
    "bag trim": ["{bag}", "{out}", "--from", "0.1s", "--to", "end-0.1s"],
    "bag filter": ["{bag}", "{out}", "--topics", "/odom", "/pose"],
    "bag merge": ["{bag}", "{given}/good", "{out}"],
    "refilter": ["{bag}", "--params", "{given}/ekf.yaml", "--compare", "/ground_truth", "--out", "{out}"],
    "calibrate": ["{bag}", "--params", "{given}/ekf.yaml", "--out", "{out}.yaml", "--until", "0.2"],
    "report": ["{bag}", "-o", "{out}.html", "--csv", "--tum"],
    "replay": ["{bag}", "--as-fast-as-possible", "--disable-keyboard-controls"],
}
"""Arguments of each command; ``out`` does not exist."""
GRAPH = ("replay",)
"""Commands that start a node."""


def bag_commands():
    """Return the names of all commands of the command line that have a bag among their arguments."""
    return {name for name, parser in leaves(cli._parser()) if {one.dest for one in parser._actions} & {"bag", "bags"}}


def leaves(parser, words=()):
    """Yield the name and the parser of each command."""
    below = [one for one in parser._actions if isinstance(one, argparse._SubParsersAction)]
    for one in below:
        for name, child in one.choices.items():
            yield from leaves(child, (*words, name))
    if not below:
        yield " ".join(words), parser


@functools.cache
def _parser():
    """Return the parser; creating it takes longer than most commands on a small bag."""
    return cli._parser()


def words_of(name, bag, given, out):
    """Return the words of a command: ``given`` is the folder of :func:`given_files`, ``out`` a path for its output."""
    return [*name.split(), *(word.format(bag=bag, given=given, out=out) for word in ARGUMENTS[name])]


def run(arguments):
    """Run the command line in this process; return its status, its output and its errors."""
    out, err = io.StringIO(), io.StringIO()
    _parser()  # cached before cli._parser is replaced
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            with mock.patch.object(cli, "_parser", _parser):
                status = cli.main(arguments)
        except SystemExit as error:
            status = error.code
        except BaseException:
            traceback.print_exc()
            status = 99
    return status, out.getvalue(), err.getvalue()


def good_rows(seconds=1.0):
    """Return topic, log time, sequence and (type, message) of a robot on a circle, with all topics of the commands."""
    rows = []
    for number in range(int(seconds * 20)):
        time = BEGIN + number * 50_000_000
        x, y, yaw = 0.02 * number, 0.01 * number, 0.02 * number
        rows += [
            ("/odom", time, number, view_bags.odometry(time, x, y, yaw, frame="odom")),
            ("/global_pose", time + 1, number, view_bags.estimate(time, x, y, yaw)),
            ("/pose", time + 2, number, view_bags.estimate(time, x, y, yaw)),
            ("/ground_truth", time + 3, number, view_bags.odometry(time, x, y, yaw)),
            ("/cmd_vel", time + 4, number, view_bags.command(0.2, 0.1)),
        ]
        if number % 5 == 0:
            rows += [
                ("/ekf/status", time + 5, number, view_bags.status("ekf", "running", **{"NIS per number": "1.0"})),
                ("/rosout", time + 6, number, view_bags.log(time, "ekf", "text")),
                ("/tf", time + 7, number, view_bags.transforms(time, ("map", "odom", 0.0, 0.0, 0.0))),
                ("/plan", time + 8, number, view_bags.path(time, (0.0, 0.0), (1.0, 1.0))),
                ("/goal_pose", time + 9, number, view_bags.goal(time, 1.0, 1.0, 0.5)),
            ]
    return rows


def given_files(folder):
    """Write the other input files of the commands."""
    folder.mkdir()
    (folder / "contract.yaml").write_text(CONTRACT)
    (folder / "ekf.yaml").write_text(PARAMETERS)
    write_folder(folder / "good", good_rows(0.5))
    return folder
