"""The command ``diffbot``: parses the arguments, imports the command's module, calls it."""

from __future__ import annotations

if __name__ == "__main__":  # before the other imports: see launcher
    from diffbot_tools.executables import diffbot

    raise SystemExit(diffbot())

import argparse
import contextlib
import importlib
import os
import signal
import sys
from collections.abc import Callable, Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any

from diffbot_bag.parameters import ReplayConfig
from diffbot_control.law.presets import PRESETS, TUNED
from diffbot_core.distribution import DISTRIBUTION, entry_points_by_name
from diffbot_core.errors import DiffbotError
from diffbot_core.launcher import end_on_signals
from diffbot_core.schema import build, to_dict
from diffbot_tools.arguments import MAX_SEED, add_flags, check_outputs, ros_parameters, whole
from diffbot_tools.bag.command import add_bag
from diffbot_tools.command_help import add_examples
from diffbot_tools.data_commands import add_calibrate, add_refilter
from diffbot_tools.dock_command import add_dock, add_undock
from diffbot_tools.goal_command import add_goal
from diffbot_tools.robot.command import add_robot
from diffbot_tools.run_command import NODES, add_run
from diffbot_tools.view.report_command import add_report
from diffbot_tools.watch.command import add_watch

COMMANDS = "diffbot.commands"
"""Group of the entry points of further commands: name -> ``package.module:function``, called with the subparsers."""


def main(args: list[str] | None = None) -> int:
    """Run the command line; return 0, 1 after an error or a missed goal, 2 for wrong usage, 130 after an interrupt."""
    parser, words = _parser(), sys.argv[1:] if args is None else args
    if "_ARGCOMPLETE" in os.environ:
        _complete(parser)
    if not words:
        parser.print_help()
        return 0
    options = parser.parse_args(words)
    if not hasattr(options, "call"):
        parser.error("a command is missing: diffbot --help lists them")
    # SIGTERM unwinds like Ctrl-C, so started processes are stopped; nodes set handlers of their own.
    for number in (signal.SIGINT, signal.SIGTERM):
        if signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, signal.default_int_handler)
    try:
        check_outputs(options)
        return int(options.call(options))
    except DiffbotError as error:
        print(f"diffbot: {error}", file=sys.stderr)
        return int(getattr(options, "error_status", 1))
    except KeyboardInterrupt:
        print("diffbot: interrupted", file=sys.stderr)
        return 130


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="diffbot", description="Go-to-pose stack for differential-drive robots.")
    parser.add_argument("--version", action="version", version=f"%(prog)s {version(DISTRIBUTION)}")
    commands = parser.add_subparsers(metavar="COMMAND")
    for add in (
        _add_demo,
        add_run,
        add_goal,
        add_dock,
        add_undock,
        _add_replay,
        add_bag,
        add_refilter,
        add_calibrate,
        add_watch,
        add_report,
        add_robot,
        *_further_commands(),
    ):
        add(commands)
    add_examples(parser)
    return parser


def _complete(parser: argparse.ArgumentParser) -> None:
    """Answer the shell that asks for completions, and end; return if argcomplete is not installed."""
    with contextlib.suppress(ImportError):
        import argcomplete  # noqa: PLC0415

        argcomplete.autocomplete(parser)


def _further_commands() -> Iterator[Callable[[Any], None]]:
    """Yield the functions that add the commands of other packages; one that cannot be imported is reported."""
    for one in entry_points_by_name(COMMANDS).values():
        try:
            yield one.load()
        except Exception as error:  # whatever it is, the other commands work
            cause = " ".join(f"{type(error).__name__}: {error}".split())
            print(f"diffbot: no command {one.name}, {one.value} cannot be imported ({cause})", file=sys.stderr)


def _add_demo(commands: Any) -> None:
    demo = commands.add_parser("demo", help="drive to three goals with the whole graph, record and evaluate the run")
    demo.add_argument("--out", type=Path, default=Path("out/demo"), help="output folder (default: %(default)s)")
    demo.add_argument("--seed", type=whole(0, MAX_SEED), default=1, help="seed of all noise (default: %(default)s)")
    demo.add_argument("--real-time", action="store_true", help="run in real time, for watching")
    demo.add_argument("--overwrite", action="store_true", help="replace the bag of an earlier run")
    demo.add_argument("--domain", type=whole(0, 232), help="ROS_DOMAIN_ID, to observe the graph (default: a free one)")
    demo.add_argument("--preset", choices=tuple(PRESETS), default=TUNED, help="controller (default: %(default)s)")
    demo.add_argument("--watch", action="store_true", help="in real time, on a page in the browser, until Ctrl-C")
    demo.set_defaults(call=_demo)


def _add_replay(commands: Any) -> None:
    replay = commands.add_parser("replay", help="republish a bag, as ros2 bag play does")
    replay.add_argument(
        "bag", type=Path, nargs="+", help="folder of a bag, or an .mcap file; several are merged by time"
    )
    add_flags(replay, ReplayConfig, without=("uri", "bags"))
    replay.add_argument("--ros-args", dest="ros_args", nargs=argparse.REMAINDER, default=[], help="remappings ...")
    replay.set_defaults(call=_replay)


def _demo(options: argparse.Namespace) -> int:
    from diffbot_tools.demo.command import DemoOptions, run_demo  # noqa: PLC0415 - only the called command is imported

    out, seed, real_time, overwrite = options.out, options.seed, options.real_time, options.overwrite
    return run_demo(DemoOptions(out, seed, real_time, overwrite, options.domain, options.preset, options.watch))


def _replay(options: argparse.Namespace) -> int:
    given = {name: value for name, value in vars(options).items() if name in to_dict(ReplayConfig())}
    first, *more = map(str, options.bag)
    given |= {"uri": first, "bags": more}
    build(ReplayConfig, given)  # refuses a bad value by the flag's name
    end_on_signals(0)
    node = importlib.import_module(NODES["replay"].module)
    return int(node.main(["--ros-args", *ros_parameters(given), *options.ros_args]))
