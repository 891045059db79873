"""The command ``diffbot``: parses the arguments, imports the command's module, calls it."""

from __future__ import annotations

if __name__ == "__main__":  # before the other imports: see launcher
    from diffbot_lab.executables import diffbot

    raise SystemExit(diffbot())

import argparse
import importlib
import json
import signal
import sys
from pathlib import Path
from typing import Any, get_args

from diffbot_bag.parameters import ReplayConfig
from diffbot_control.law.presets import PRESETS, TUNED
from diffbot_core.errors import DiffbotError
from diffbot_core.launcher import end_on_signals
from diffbot_core.schema import build, parameters_of, to_dict
from diffbot_lab.arguments import MAX_SEED, once, setting, whole, yaml_value
from diffbot_lab.bag.command import add_bag
from diffbot_lab.benchmark_commands import add_benchmark
from diffbot_lab.campaign.options import CampaignOptions
from diffbot_lab.data_commands import add_calibrate, add_import, add_refilter
from diffbot_lab.goal_command import add_goal
from diffbot_lab.interfaces.command import add_interfaces
from diffbot_lab.run_command import NODES, add_run
from diffbot_lab.stability.command import add_stability
from diffbot_lab.view.report_command import add_report
from diffbot_lab.watch.command import add_watch

RUNS_OF_EXPERIMENTS, RUNS_OF_SCAN, SEED_OF_SCAN = 100, 2000, 2
"""Defaults; the scan's seed is held out: its box was chosen on other runs."""


def main(args: list[str] | None = None) -> int:
    """Run the command line; return 0, 1 after an error or a missed goal, 2 for wrong usage, 130 after an interrupt."""
    options = _parser().parse_args(args)
    # SIGTERM unwinds like Ctrl-C, so started processes are stopped; nodes set handlers of their own.
    for number in (signal.SIGINT, signal.SIGTERM):
        if signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, signal.default_int_handler)
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
    for add in (
        _add_demo,
        _add_experiment,
        _add_campaign,
        add_stability,
        add_benchmark,
        add_run,
        add_goal,
        _add_replay,
    ):
        add(commands)
    add_bag(commands)
    add_import(commands)
    add_refilter(commands)
    add_calibrate(commands)
    add_watch(commands)
    add_report(commands)
    add_interfaces(commands)
    return parser


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


def _add_experiment(commands: Any) -> None:
    experiment = commands.add_parser("experiment", help="reproduce the paper's simulations A and B, figures 4 to 15")
    experiment.add_argument(
        "names", nargs="+", choices=("a", "b", "scan"), help="simulation A, B; scan: readings of A over eps_P"
    )
    experiment.add_argument(
        "--runs", type=whole(1, 10**6), help="a, b: of each start (default: 100); scan: of each cell (default: 2000)"
    )
    experiment.add_argument("--seed", type=whole(0, MAX_SEED), help="seed of all noise (default: 1; scan: 2)")
    experiment.add_argument("--out", type=Path, default=Path("out/experiment"), help="folder (default: %(default)s)")
    experiment.add_argument("--no-figures", dest="figures", action="store_false", help="results.json and table only")
    experiment.set_defaults(call=_experiment)


def _add_campaign(commands: Any) -> None:
    campaign = commands.add_parser("campaign", help="Monte-Carlo runs over a grid of parameters")
    campaign.add_argument("file", type=Path, nargs="?", help="YAML file (docs/reference/campaigns.md)")
    _add_flags(campaign, CampaignOptions)
    campaign.add_argument(
        "--start", type=yaml_value, help="e.g. '{box: {x: [-5, 5], y: [-5, 5], heading: [-3.14, 3.14]}}'"
    )
    campaign.add_argument("--set", type=setting, nargs="+", default=[], metavar="NAME=VALUE", help="for all cells")
    campaign.add_argument(
        "--grid", type=setting, nargs="+", default=[], metavar="NAME=[A,B]", help="one cell per combination"
    )
    campaign.add_argument("--out", type=Path, default=Path("out/campaign"), help="folder (default: %(default)s)")
    campaign.add_argument("--workers", type=whole(1, 1024), help="processes (default: one per core)")
    campaign.add_argument(
        "--scheduler", metavar="ADDRESS", help="run on a dask.distributed cluster, e.g. tcp://host:8786"
    )
    campaign.set_defaults(call=_campaign)


def _add_replay(commands: Any) -> None:
    replay = commands.add_parser("replay", help="republish a bag, as ros2 bag play does")
    replay.add_argument(
        "bag", type=Path, nargs="+", help="folder of a bag, or an .mcap file; several are merged by time"
    )
    _add_flags(replay, ReplayConfig, without=("uri", "bags"))
    replay.add_argument("--ros-args", dest="ros_args", nargs=argparse.REMAINDER, default=[], help="remappings ...")
    replay.set_defaults(call=_replay)


def _add_flags(parser: argparse.ArgumentParser, config_type: type[Any], without: tuple[str, ...] = ()) -> None:
    """Add a flag for each parameter of a configuration; flags that are not given are absent from the result."""
    for parameter in parameters_of(config_type):
        if parameter.name in without:
            continue
        default = " ".join(map(str, parameter.default)) if isinstance(parameter.default, tuple) else parameter.default
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
            options |= {"nargs": "+", "type": get_args(parameter.type)[0]}
        parser.add_argument("--" + parameter.name.replace("_", "-").replace(".", "-"), dest=parameter.name, **options)


def _demo(options: argparse.Namespace) -> int:
    from diffbot_lab.demo.command import DemoOptions, run_demo  # noqa: PLC0415 - only the called command is imported

    out, seed, real_time, overwrite = options.out, options.seed, options.real_time, options.overwrite
    return run_demo(DemoOptions(out, seed, real_time, overwrite, options.domain, options.preset, options.watch))


def _experiment(options: argparse.Namespace) -> int:
    from diffbot_lab.paper.experiment import run_and_report  # noqa: PLC0415
    from diffbot_lab.paper.scan import run_and_report as run_and_report_scan  # noqa: PLC0415

    runs, seed = options.runs, options.seed
    if drives := tuple(dict.fromkeys(name for name in options.names if name != "scan")):
        run_and_report(drives, runs or RUNS_OF_EXPERIMENTS, 1 if seed is None else seed, options.out, options.figures)
    if "scan" in options.names:
        run_and_report_scan(runs or RUNS_OF_SCAN, SEED_OF_SCAN if seed is None else seed, options.out / "scan")
    return 0


def _campaign(options: argparse.Namespace) -> int:
    from diffbot_lab.campaign import command as campaign_command  # noqa: PLC0415

    flags = {name: value for name, value in vars(options).items() if name in to_dict(CampaignOptions())}
    if options.start is not None:
        flags["start"] = options.start
    flags |= {"set": once("--set", options.set), "grid": once("--grid", options.grid)}
    return campaign_command.run(options.file, flags, options.out, options.workers, options.scheduler)


def _replay(options: argparse.Namespace) -> int:
    given = {name: value for name, value in vars(options).items() if name in to_dict(ReplayConfig())}
    first, *more = map(str, options.bag)
    given |= {"uri": first, "bags": more}
    build(ReplayConfig, given)  # refuses a bad value by the flag's name
    # ROS parses values as YAML, of which JSON is a subset.
    arguments = [part for name, value in given.items() for part in ("-p", f"{name}:={json.dumps(value)}")]
    end_on_signals(0)
    node = importlib.import_module(NODES["replay"].module)
    return int(node.main(["--ros-args", *arguments, *options.ros_args]))
