"""Commands of the lab on the command line. Each command imports its module when it runs."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from diffbot_core.schema import to_dict
from diffbot_lab.campaign.options import CampaignOptions
from diffbot_tools.arguments import MAX_SEED, add_flags, once, setting, whole, yaml_value


def add_experiment(commands: Any) -> None:
    """Add ``diffbot experiment`` to the subparsers of the command line."""
    experiment = commands.add_parser("experiment", help="reproduce the paper's simulations A and B, figures 4 to 15")
    experiment.add_argument("names", nargs="+", choices=("a", "b"), help="simulation A or B")
    _add_runs(experiment, 100, "runs of each start")
    _add_seed_and_out(experiment, "out/experiment")
    experiment.set_defaults(call=_experiment)


def add_benchmark(commands: Any) -> None:
    """Add ``diffbot benchmark`` to the subparsers of the command line."""
    benchmark = commands.add_parser("benchmark", help="compare laws, docking and filters; tune laws")
    parts = benchmark.add_subparsers(required=True, metavar="PART", dest="part")

    switching = parts.add_parser("switching", help="compare the switching law with other laws under equal conditions")
    _add_names(switching, "--law", "compare the switching law with LAW: a name, or package.module:Class")
    _add_names(switching, "--case", "run CASE")
    switching.add_argument("--tuning", type=Path, metavar="FILE", help="tuning.json of diffbot benchmark tune")
    _add_runs(switching, 100, "runs of each start")
    _add_runs(switching, 1, "runs of each start for the switching law, if more than --runs", "--own-runs")
    _add_seed_and_out(switching, "out/benchmark")
    switching.set_defaults(call=_switching)

    localization = parts.add_parser("localization", help="compare the variants of the filter on the same drives")
    _add_runs(localization, 200, "drives of each case")
    _add_seed_and_out(localization, "out/localization")
    localization.set_defaults(call=_localization)

    docking = parts.add_parser("docking", help="compare docking with Nav2's docking server")
    _add_names(docking, "--case", "run CASE")
    _add_runs(docking, 17_000, "runs of each law in each case")
    _add_seed_and_out(docking, "out/docking")
    docking.set_defaults(call=_docking)

    tune = parts.add_parser("tune", help="tune the other laws, each with the same budget, and write tuning.json")
    _add_names(tune, "--law", "tune LAW: a name, or package.module:Class")
    tune.add_argument(
        "--budget", type=whole(1, 10**6), default=480, help="evaluations for each law (default: %(default)s)"
    )
    _add_out(tune, "out/tuning")
    tune.set_defaults(call=_tune)


def add_campaign(commands: Any) -> None:
    """Add ``diffbot campaign`` to the subparsers of the command line."""
    campaign = commands.add_parser("campaign", help="simulate many random runs over a grid of parameters")
    campaign.add_argument("file", type=Path, nargs="?", help="YAML file (docs/reference/campaigns.md)")
    add_flags(campaign, CampaignOptions)
    campaign.add_argument(
        "--start", type=yaml_value, help="start poses, e.g. '{box: {x: [-5, 5], y: [-5, 5], heading: [-3.14, 3.14]}}'"
    )
    campaign.add_argument(
        "--set", type=setting, nargs="+", default=[], metavar="NAME=VALUE", help="parameters of all cells"
    )
    campaign.add_argument(
        "--grid",
        type=setting,
        nargs="+",
        default=[],
        metavar="NAME=[A,B]",
        help="values of parameters; each combination is one cell",
    )
    _add_out(campaign, "out/campaign")
    place = campaign.add_mutually_exclusive_group()
    place.add_argument("--workers", type=whole(1, 1024), help="processes (default: one per core)")
    place.add_argument("--scheduler", metavar="ADDRESS", help="run on a dask.distributed cluster, e.g. tcp://host:8786")
    campaign.set_defaults(call=_campaign)


def _add_names(parser: Any, flag: str, text: str) -> None:
    metavar = flag[2:].upper()
    parser.add_argument(
        flag, action="append", default=[], metavar=metavar, help=f"{text}; may be given several times (default: all)"
    )


def _add_runs(parser: Any, default: int, text: str, flag: str = "--runs") -> None:
    parser.add_argument(flag, type=whole(1, 10**6), default=default, help=f"{text} (default: %(default)s)")


def _add_seed_and_out(parser: Any, folder: str) -> None:
    parser.add_argument("--seed", type=whole(0, MAX_SEED), default=1, help="seed of all noise (default: %(default)s)")
    _add_out(parser, folder)


def _add_out(parser: Any, folder: str) -> None:
    parser.add_argument("--out", type=Path, default=Path(folder), help="output folder (default: %(default)s)")


def _experiment(options: argparse.Namespace) -> int:
    from diffbot_lab.paper.experiment import run_and_report  # noqa: PLC0415

    return run_and_report(tuple(dict.fromkeys(options.names)), options.runs, options.seed, options.out)


def _switching(options: argparse.Namespace) -> int:
    from diffbot_lab.benchmark.entries import TUNING  # noqa: PLC0415
    from diffbot_lab.benchmark.report import run_and_report  # noqa: PLC0415
    from diffbot_lab.benchmark.runs import BenchmarkOptions  # noqa: PLC0415

    laws, cases, tuning = tuple(options.law), tuple(options.case), options.tuning or TUNING
    given = BenchmarkOptions(options.runs, options.seed, laws, cases, tuning, options.own_runs)
    return run_and_report(given, options.out)


def _localization(options: argparse.Namespace) -> int:
    from diffbot_lab.filter_benchmark import run_and_report  # noqa: PLC0415

    return run_and_report(options.runs, options.seed, options.out)


def _docking(options: argparse.Namespace) -> int:
    from diffbot_lab.benchmark.docking import run_and_report  # noqa: PLC0415

    return run_and_report(options.runs, options.seed, tuple(options.case), options.out)


def _tune(options: argparse.Namespace) -> int:
    from diffbot_lab.benchmark.tuning import run_and_report  # noqa: PLC0415

    return run_and_report(tuple(options.law), options.budget, options.out)


def _campaign(options: argparse.Namespace) -> int:
    from diffbot_lab.campaign.report import run_and_report  # noqa: PLC0415

    flags = {name: value for name, value in vars(options).items() if name in to_dict(CampaignOptions())}
    if options.start is not None:
        flags["start"] = options.start
    flags |= {"set": once("--set", options.set), "grid": once("--grid", options.grid)}
    return run_and_report(options.file, flags, options.out, options.workers, options.scheduler)
