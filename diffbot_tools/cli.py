"""The command ``diffbot``: parse the arguments, import the module of the command, call it."""

from __future__ import annotations

import argparse
import contextlib
import importlib
import math
import os
import signal
import sys
import textwrap
from collections.abc import Callable, Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any

from diffbot_bag.parameters import ReplayConfig
from diffbot_control.law.registry import PRESETS, TUNED
from diffbot_core.errors import DiffbotError
from diffbot_core.installed import DISTRIBUTION, entry_points_by_name
from diffbot_core.launcher import end_on_signals
from diffbot_core.schema import build, to_dict
from diffbot_tools.arguments import MAX_SEED, add_flags, add_remap, check_paths, duration, once, ros_parameters, whole
from diffbot_tools.bag.command import add_bag
from diffbot_tools.check.command import add_check
from diffbot_tools.drive import MAX_DOMAIN, add_drive
from diffbot_tools.robot_command import add_robot
from diffbot_tools.run_command import NODES, add_run
from diffbot_tools.view.report_command import add_report
from diffbot_tools.watch.command import add_watch

COMMANDS = "diffbot.commands"
"""Group of entry points. Each is a function that adds commands to the subparsers that it is called with."""
EXAMPLES: dict[str, tuple[str, ...]] = {
    "demo": ("demo", "demo --watch"),
    "run": ("run robot --with plant recorder", "run robot --ros-args --params-file my_robot.yaml"),
    "goal": ("goal 2 1 1.57", "goal 2 1 90deg", "goal 0.5 0 0 --namespace robot1 --timeout 60"),
    "dock": ("dock", "dock 3 1 0.5", "dock 3 1 30deg --backward"),
    "undock": ("undock", "undock --distance 1"),
    "check": ("check", "check my_robot.yaml --namespace robot1", "check --ros-args -r odom:=/base/odom"),
    "watch": ("watch --open", "watch --namespace robot1 robot2 --record bags"),
    "robot": ("robot new my_robot.yaml", "robot drive turtlebot4"),
    "robot new": ("robot new my_robot.yaml", "robot new agv.yaml --like warehouse_agv --linear-x-max-velocity 0.8"),
    "robot check": ("robot check my_robot.yaml",),
    "robot drive": ("robot drive my_robot.yaml", "robot drive turtlebot3_burger --goals 50 --out burger.png"),
    "calibrate": ("calibrate first_drive --params my_robot.yaml --out calibrated.yaml",),
    "bag": ("bag info run1",),
    "bag info": ("bag info run1", "bag info run1 --json"),
    "bag check": ("bag check run1 contract.yaml",),
    "bag trim": ("bag trim run1 part --from 10s --to 20s",),
    "bag filter": ("bag filter run1 poses --topics /pose /odom",),
    "bag merge": ("bag merge run1 run2 both",),
    "bag repair": ("bag repair run1 saved",),
    "report": ("report run1", "report run1 -o run1.html --csv"),
    "replay": ("replay run1", "replay run1 --rate 2 --start-paused"),
    "refilter": ("refilter run1 --params my_robot.yaml --out run1_again --compare /ground_truth",),
    "campaign": ("campaign --runs 500 --grid fix_delay=[0.0,0.2,0.4]", "campaign campaign.yaml --out out/mine"),
    "benchmark": ("benchmark switching --case nominal",),
    "benchmark switching": ("benchmark switching --law graceful --case nominal",),
    "benchmark localization": ("benchmark localization --runs 50",),
    "benchmark docking": ("benchmark docking --runs 170 --case docking_no_loss",),
    "benchmark tune": ("benchmark tune --law graceful --budget 120",),
    "experiment": ("experiment a b",),
    "stability": ("stability certify",),
    "stability certify": ("stability certify",),
    "stability adversary": ("stability adversary out/stability/certificate.json",),
    "stability verify": ("stability verify out/stability/certificate.json",),
}
"""Examples in the help of each command, by the name of the command."""
BROKEN_PIPE = 141
"""Exit status if the process that reads the output has ended, the same as after SIGPIPE."""


def main(args: list[str] | None = None) -> int:
    """Run the command line.

    Returns:
        Exit status: 0 for success, 1 after an error or a missed goal, 2 for wrong usage, 130 after an interrupt, 141 if
        the process that reads the output has ended.
    """
    parser, words = _parser(), sys.argv[1:] if args is None else args
    if "_ARGCOMPLETE" in os.environ:
        _complete(parser)
    if not words:
        parser.print_help()
        return 0
    options = parser.parse_args(words)
    if not hasattr(options, "call"):
        parser.error("a command is missing: diffbot --help lists them")
    # SIGTERM raises KeyboardInterrupt like Ctrl-C, so that started processes are stopped. Nodes set their own handlers.
    for number in (signal.SIGINT, signal.SIGTERM):
        if signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, signal.default_int_handler)
    try:
        check_paths(options)
        status = int(options.call(options))
        sys.stdout.flush()
        return status
    except DiffbotError as error:
        print(f"diffbot: {error}", file=sys.stderr)
        return int(getattr(options, "error_status", 1))
    except KeyboardInterrupt:
        print("diffbot: interrupted", file=sys.stderr)
        return 130
    except BrokenPipeError:
        # Python flushes the output again when it exits.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return BROKEN_PIPE


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="diffbot", description="Go-to-pose stack for differential-drive robots.")
    parser.add_argument("--version", action="version", version=f"%(prog)s {version(DISTRIBUTION)}")
    commands = parser.add_subparsers(metavar="COMMAND")
    for add in (
        _add_demo,
        add_run,
        add_drive,
        _add_replay,
        add_bag,
        _add_refilter,
        _add_calibrate,
        add_check,
        add_watch,
        add_report,
        add_robot,
        *_further_commands(),
    ):
        add(commands)
    _add_examples(parser)
    return parser


def _add_examples(parser: argparse.ArgumentParser, words: tuple[str, ...] = ()) -> None:
    """Add the examples to the help of every command below ``parser``; ``words`` are the name of ``parser`` itself."""
    commands = [one.choices for one in parser._actions if isinstance(one, argparse._SubParsersAction)]
    for name, command in (item for choices in commands for item in choices.items()):
        full_name = (*words, name)
        if examples := EXAMPLES.get(" ".join(full_name)):
            text = "\n  diffbot ".join(("examples:", *examples))
            command.epilog = "\n\n".join(part for part in (textwrap.fill(command.epilog or "", 100), text) if part)
            command.description = textwrap.fill(command.description or "", 100)
            command.formatter_class = argparse.RawDescriptionHelpFormatter
        _add_examples(command, full_name)


def _complete(parser: argparse.ArgumentParser) -> None:
    """Print the completions that the shell requests and exit; return if argcomplete is not installed."""
    with contextlib.suppress(ImportError):
        import argcomplete  # noqa: PLC0415

        argcomplete.autocomplete(parser)


def _further_commands() -> Iterator[Callable[[Any], None]]:
    """Yield the functions that add the commands of other packages; report functions that cannot be imported."""
    for one in entry_points_by_name(COMMANDS).values():
        try:
            yield one.load()
        except Exception as error:  # an import can raise anything; the other commands still work
            cause = " ".join(f"{type(error).__name__}: {error}".split())
            print(f"diffbot: the command {one.name} is missing: cannot import {one.value} ({cause})", file=sys.stderr)


def _add_demo(commands: Any) -> None:
    demo = commands.add_parser("demo", help="run the whole graph: drive to three goals, record and evaluate the run")
    demo.add_argument("--out", type=Path, default=Path("out/demo"), help="output folder (default: %(default)s)")
    demo.add_argument("--seed", type=whole(0, MAX_SEED), default=1, help="seed of all noise (default: %(default)s)")
    demo.add_argument("--real-time", action="store_true", help="run in real time instead of lock-step")
    demo.add_argument("--overwrite", action="store_true", help="replace the bag of an earlier run")
    demo.add_argument(
        "--domain", type=whole(0, MAX_DOMAIN), help="ROS_DOMAIN_ID, to observe the graph (default: a free one)"
    )
    demo.add_argument(
        "--preset", choices=tuple(PRESETS), default=TUNED, help="preset of the controller (default: %(default)s)"
    )
    demo.add_argument(
        "--watch", action="store_true", help="show the run on a page in the browser, in real time, until Ctrl-C"
    )
    demo.set_defaults(call=_demo)


def _add_replay(commands: Any) -> None:
    replay = commands.add_parser("replay", help="republish a bag, as ros2 bag play does")
    replay.add_argument(
        "bag", type=Path, nargs="+", help="folder of a bag, or an .mcap file; several bags are merged by time"
    )
    add_flags(replay, ReplayConfig, without=("uri", "bags"))
    replay.add_argument("--ros-args", dest="ros_args", nargs=argparse.REMAINDER, default=[], help="remappings")
    replay.set_defaults(call=_replay)


def _add_refilter(commands: Any) -> None:
    refilter = commands.add_parser("refilter", help="run the filter over a recorded bag, without a graph")
    refilter.add_argument("bag", type=Path, help="folder of the bag, or an .mcap file")
    refilter.add_argument("--params", type=Path, help="ROS parameter file (default: ekf.yaml in the folder of the bag)")
    refilter.add_argument("--out", type=Path, required=True, help="folder of the new bag, which must not exist")
    refilter.add_argument("--compare", metavar="TOPIC", help="print the errors against the true poses of this topic")
    add_remap(refilter, None, "topic in the bag for an input of the ekf, e.g. odom:=/robot1/odom")
    refilter.set_defaults(call=_refilter)


def _add_calibrate(commands: Any) -> None:
    calibrate = commands.add_parser("calibrate", help="estimate the parameters of a robot from recorded drives")
    calibrate.add_argument("bags", type=Path, nargs="+", metavar="BAG", help="folder of a bag, or an .mcap file")
    calibrate.add_argument(
        "--params", type=Path, help="ROS parameter file (default: ekf.yaml in the folder of the first bag)"
    )
    calibrate.add_argument(
        "--out", type=Path, default=Path("calibrated.yaml"), help="parameter file to write (default: %(default)s)"
    )
    calibrate.add_argument(
        "--until", type=duration, default=math.inf, metavar="SECONDS", help="use only the first SECONDS of each drive"
    )
    add_remap(calibrate, None, "topic in the bag for cmd_vel or an input of the ekf, e.g. odom:=/robot1/odom")
    calibrate.set_defaults(call=_calibrate)


def _demo(options: argparse.Namespace) -> int:
    from diffbot_tools.demo import DemoOptions, run_demo  # noqa: PLC0415 - only the called command is imported

    return run_demo(DemoOptions(**{name: getattr(options, name) for name in DemoOptions._fields}))


def _replay(options: argparse.Namespace) -> int:
    given = {name: value for name, value in vars(options).items() if name in to_dict(ReplayConfig())}
    first, *more = map(str, options.bag)
    given |= {"uri": first, "bags": more}
    build(ReplayConfig, given)  # an error names the flag
    end_on_signals(0)
    node = importlib.import_module(NODES["replay"].module)
    return int(node.main(["--ros-args", *ros_parameters(given), *options.ros_args]))


def _refilter(options: argparse.Namespace) -> int:
    from diffbot_tools import refilter  # noqa: PLC0415

    return refilter.run(options.bag, options.params, options.out, options.compare, once("--remap", options.remap))


def _calibrate(options: argparse.Namespace) -> int:
    from diffbot_tools.calibration import command as calibration_command  # noqa: PLC0415

    return calibration_command.run(
        options.bags, options.params, options.out, options.until, once("--remap", options.remap)
    )


if __name__ == "__main__":
    raise SystemExit(main())
