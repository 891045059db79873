"""The command ``diffbot``: parses, imports what is needed, calls."""

from __future__ import annotations

import argparse
import importlib
import json
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from diffbot_bag.config import ReplayConfig
from diffbot_control.config import build, parameters_of, to_dict
from diffbot_control.errors import DiffbotError

NODES = {
    "plant": "diffbot_sim.plant_node",
    "ekf": "diffbot_control.ekf_node",
    "controller": "diffbot_control.controller_node",
    "recorder": "diffbot_bag.recorder_node",
    "replay": "diffbot_bag.replay_node",
}


def main(args: list[str] | None = None) -> int:
    """Run the command line; return 0, 1 after an error or a missed goal, 2 for wrong usage, 130 after Ctrl-C."""
    options = _parser().parse_args(args)
    # SIGTERM ends what was started as Ctrl-C does; the nodes set handlers of their own.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        return int(options.call(options))
    except DiffbotError as error:
        print(f"diffbot: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("diffbot: interrupted", file=sys.stderr)
        return 130


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="diffbot", description="Go-to-pose stack for differential-drive robots.")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    demo = commands.add_parser("demo", help="drive, record and judge three goals with the whole graph")
    demo.add_argument("--out", type=Path, default=Path("out/demo"), help="output folder (default: %(default)s)")
    demo.add_argument("--seed", type=_whole(0, 2**63 - 1), default=1, help="seed of all noise (default: %(default)s)")
    demo.add_argument(
        "--real-time",
        action="store_true",
        help="run at the pace of the clock on the wall, for watching",
    )
    demo.add_argument("--overwrite", action="store_true", help="replace the bag of an earlier run")
    demo.add_argument(
        "--domain",
        type=_whole(0, 232),
        help="ROS_DOMAIN_ID, to look on with other tools (default: a free one)",
    )
    demo.set_defaults(call=_demo)

    node = commands.add_parser(
        "run", help="run one node, as ros2 run does", description="Run one node in this process."
    )
    node.add_argument("node", choices=sorted(NODES))
    node.add_argument("ros_args", nargs=argparse.REMAINDER, help="--ros-args ...")
    node.set_defaults(call=_run_node)

    replay = commands.add_parser("replay", help="republish a bag, as ros2 bag play does")
    replay.add_argument("bag", type=Path, help="folder of the bag, or an .mcap file")
    _add_flags(replay, ReplayConfig, without=("uri",))
    replay.add_argument("--ros-args", dest="ros_args", nargs=argparse.REMAINDER, default=[], help="remappings ...")
    replay.set_defaults(call=_replay)
    return parser


def _add_flags(parser: argparse.ArgumentParser, config_type: type[Any], without: tuple[str, ...]) -> None:
    """Make a flag of each parameter of a configuration; only flags that are given appear in the result."""
    for parameter in parameters_of(config_type):
        if parameter.name in without:
            continue
        default = " ".join(parameter.default) if isinstance(parameter.default, tuple) else parameter.default
        unit = "" if parameter.spec.unit == "-" else f" [{parameter.spec.unit}]"
        options: dict[str, Any] = {
            "help": f"{parameter.spec.text}{unit}" + (f" (default: {default})" if default not in ("", False) else ""),
            "default": argparse.SUPPRESS,
        }
        if parameter.type is bool:
            options["action"] = "store_true"
        elif parameter.type in (float, int):
            options["type"] = parameter.type
        elif parameter.type is not str:
            options["nargs"] = "+"
        parser.add_argument("--" + parameter.name.replace("_", "-").replace(".", "-"), dest=parameter.name, **options)


def _whole(low: int, high: int) -> Callable[[str], int]:
    def whole(text: str) -> int:
        number = int(text)
        if not low <= number <= high:
            raise argparse.ArgumentTypeError(f"{text}: must be from {low} to {high}")
        return number

    return whole


def _demo(options: argparse.Namespace) -> int:
    from diffbot_sim.demo import DemoOptions, run_demo  # noqa: PLC0415 - nothing is imported that is not called

    return run_demo(DemoOptions(options.out, options.seed, options.real_time, options.overwrite, options.domain))


def _run_node(options: argparse.Namespace) -> int:
    return int(importlib.import_module(NODES[options.node]).main(options.ros_args))


def _replay(options: argparse.Namespace) -> int:
    given = {name: value for name, value in vars(options).items() if name in to_dict(ReplayConfig())}
    given["uri"] = str(options.bag)
    build(ReplayConfig, given)  # a bad value is refused here, in the words of the flag's name
    # JSON is YAML, which is what ROS reads a value as.
    arguments = [part for name, value in given.items() for part in ("-p", f"{name}:={json.dumps(value)}")]
    node = importlib.import_module(NODES["replay"])
    return int(node.main(["--ros-args", *arguments, *options.ros_args]))


if __name__ == "__main__":
    sys.exit(main())
