"""Arguments and calls of the commands on recorded data: ``diffbot refilter`` and ``diffbot calibrate``."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import Any

from diffbot_core.errors import DiffbotError
from diffbot_tools.arguments import duration


def add_refilter(commands: Any) -> None:
    """Add ``diffbot refilter`` to the subparsers of the command line."""
    refilter = commands.add_parser("refilter", help="run the filter over a recorded bag, without a graph")
    refilter.add_argument("bag", type=Path, help="folder of the bag, or an .mcap file")
    refilter.add_argument("--params", type=Path, help="ROS parameter file (default: ekf.yaml in the folder of the bag)")
    refilter.add_argument("--out", type=Path, required=True, help="folder of the new bag, which must not exist")
    refilter.add_argument("--compare", metavar="TOPIC", help="true poses in the bag, e.g. /ground_truth")
    _add_remap(refilter)
    refilter.set_defaults(call=_refilter)


def add_calibrate(commands: Any) -> None:
    """Add ``diffbot calibrate`` to the subparsers of the command line."""
    calibrate = commands.add_parser("calibrate", help="find the parameters of a robot from drives recorded with it")
    calibrate.add_argument("bags", type=Path, nargs="+", metavar="BAG", help="folder of a bag, or an .mcap file")
    calibrate.add_argument(
        "--params", type=Path, help="ROS parameter file (default: ekf.yaml in the folder of the first bag)"
    )
    calibrate.add_argument(
        "--out", type=Path, default=Path("calibrated.yaml"), help="parameter file to write (default: %(default)s)"
    )
    calibrate.add_argument(
        "--until", type=duration, default=math.inf, metavar="SECONDS", help="use only the beginning of each drive"
    )
    _add_remap(calibrate)
    calibrate.set_defaults(call=_calibrate)


def _add_remap(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--remap", type=_remapping, nargs="+", default=[], metavar="NAME:=TOPIC", help="e.g. odom:=/robot1/odom"
    )


def _remapping(text: str) -> tuple[str, str]:
    from diffbot_tools.refilter.filter_run import INPUTS  # noqa: PLC0415 - loads scipy

    name, found, topic = text.partition(":=")
    if not found or not topic or name.lstrip("/") not in INPUTS:
        raise argparse.ArgumentTypeError(f"{text!r}: must be NAME:=TOPIC with a NAME of {', '.join(INPUTS)}")
    return name.lstrip("/"), topic


def _refilter(options: argparse.Namespace) -> int:
    from diffbot_tools.refilter import command as refilter_command  # noqa: PLC0415

    return refilter_command.run(options.bag, options.params, options.out, options.compare, _remap(options))


def _calibrate(options: argparse.Namespace) -> int:
    from diffbot_tools.calibration import command as calibration_command  # noqa: PLC0415

    return calibration_command.run(options.bags, options.params, options.out, options.until, _remap(options))


def _remap(options: argparse.Namespace) -> dict[str, str]:
    remap = dict(options.remap)
    if len(remap) < len(options.remap):
        raise DiffbotError("--remap: each name can be given once")
    return remap
