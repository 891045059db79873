"""Commands of the lab on the command line; their modules are imported when they are called."""

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
    _add_runs(experiment, 10**6, 100, "runs of each start")
    _add_seed(experiment)
    _add_out(experiment, "out/experiment")
    _add_no_figures(experiment)
    experiment.set_defaults(call=_experiment)


def add_benchmark(commands: Any) -> None:
    """Add ``diffbot benchmark`` to the subparsers of the command line."""
    benchmark = commands.add_parser("benchmark", help="the law and its peers, their tuning, docking, the filter")
    parts = benchmark.add_subparsers(required=True, metavar="PART", dest="part")
    for add in (_add_switching, _add_localization, _add_docking, _add_tune):
        add(parts)


def _add_switching(parts: Any) -> None:
    switching = parts.add_parser("switching", help="the switching law and its peers under equal conditions")
    _add_laws(switching, "compare the switching law with this law")
    _add_cases(switching)
    switching.add_argument("--tuning", type=Path, metavar="FILE", help="tuning.json of diffbot benchmark tune")
    _add_runs(switching, 10**5, 100, "runs of each start")
    switching.add_argument(
        "--own-runs",
        type=whole(1, 10**5),
        default=1,
        help="runs of each start for the switching law, if more than --runs",
    )
    _add_seed(switching)
    _add_out(switching, "out/benchmark")
    _add_no_figures(switching)
    switching.set_defaults(call=_switching)


def _add_localization(parts: Any) -> None:
    localization = parts.add_parser("localization", help="the variants of the filter on the same simulated drives")
    _add_runs(localization, 10**5, 200, "drives of each case")
    _add_seed(localization)
    _add_out(localization, "out/localization")
    _add_no_figures(localization)
    localization.set_defaults(call=_localization)


def _add_docking(parts: Any) -> None:
    docking = parts.add_parser("docking", help="docking beside Nav2's docking server")
    _add_cases(docking)
    _add_runs(docking, 10**5, 17_000, "runs of each law in each case")
    _add_seed(docking)
    _add_out(docking, "out/docking")
    _add_no_figures(docking)
    docking.set_defaults(call=_docking)


def _add_tune(parts: Any) -> None:
    tune = parts.add_parser("tune", help="tune the peers, each with the same budget; writes tuning.json")
    _add_laws(tune, "tune this law")
    _add_cases(tune)
    tune.add_argument(
        "--budget", type=whole(1, 10**6), default=480, help="evaluations for each law (default: %(default)s)"
    )
    _add_runs(tune, 10**5, 102, "runs of each case in an evaluation")
    _add_out(tune, "out/tuning")
    tune.set_defaults(call=_tune)


def _add_laws(parser: Any, what: str) -> None:
    parser.add_argument(
        "--law",
        action="append",
        default=[],
        metavar="LAW",
        help=f"{what}: a name, or package.module:Class; may be repeated (default: all)",
    )


def _add_cases(parser: Any) -> None:
    parser.add_argument("--case", action="append", default=[], help="run this case; may be repeated (default: all)")


def _add_runs(parser: Any, largest: int, default: int, what: str) -> None:
    parser.add_argument("--runs", type=whole(1, largest), default=default, help=f"{what} (default: %(default)s)")


def _add_seed(parser: Any) -> None:
    parser.add_argument("--seed", type=whole(0, MAX_SEED), default=1, help="seed of all noise (default: %(default)s)")


def _add_out(parser: Any, folder: str) -> None:
    parser.add_argument("--out", type=Path, default=Path(folder), help="folder (default: %(default)s)")


def _add_no_figures(parser: Any) -> None:
    parser.add_argument("--no-figures", dest="figures", action="store_false", help="results.json and table only")


def add_campaign(commands: Any) -> None:
    """Add ``diffbot campaign`` to the subparsers of the command line."""
    campaign = commands.add_parser("campaign", help="Monte-Carlo runs over a grid of parameters")
    campaign.add_argument("file", type=Path, nargs="?", help="YAML file (docs/reference/campaigns.md)")
    add_flags(campaign, CampaignOptions)
    campaign.add_argument(
        "--start", type=yaml_value, help="e.g. '{box: {x: [-5, 5], y: [-5, 5], heading: [-3.14, 3.14]}}'"
    )
    campaign.add_argument("--set", type=setting, nargs="+", default=[], metavar="NAME=VALUE", help="for all cells")
    campaign.add_argument(
        "--grid", type=setting, nargs="+", default=[], metavar="NAME=[A,B]", help="one cell per combination"
    )
    _add_out(campaign, "out/campaign")
    campaign.add_argument("--workers", type=whole(1, 1024), help="processes (default: one per core)")
    campaign.add_argument(
        "--scheduler", metavar="ADDRESS", help="run on a dask.distributed cluster, e.g. tcp://host:8786"
    )
    campaign.set_defaults(call=_campaign)


def _experiment(options: argparse.Namespace) -> int:
    from diffbot_lab.paper.experiment import run_and_report  # noqa: PLC0415

    names = tuple(dict.fromkeys(options.names))
    run_and_report(names, options.runs, options.seed, options.out, options.figures)
    return 0


def _switching(options: argparse.Namespace) -> int:
    from diffbot_lab.arena.command import ArenaOptions, run_and_report  # noqa: PLC0415

    laws, cases = tuple(options.law), tuple(options.case)
    arena = ArenaOptions(options.runs, options.seed, laws, cases, options.tuning, options.own_runs)
    return run_and_report(arena, options.out, options.figures)


def _localization(options: argparse.Namespace) -> int:
    from diffbot_lab.filter_benchmark.command import run_and_report  # noqa: PLC0415

    return run_and_report(options.runs, options.seed, options.out, options.figures)


def _docking(options: argparse.Namespace) -> int:
    from diffbot_lab.arena.docking.report import run_and_report  # noqa: PLC0415

    return run_and_report(options.runs, options.seed, tuple(options.case), options.out, options.figures)


def _tune(options: argparse.Namespace) -> int:
    from diffbot_lab.arena.tuning import run_and_report  # noqa: PLC0415

    return run_and_report(tuple(options.law), options.budget, options.runs, tuple(options.case), options.out)


def _campaign(options: argparse.Namespace) -> int:
    from diffbot_lab.campaign import command as campaign_command  # noqa: PLC0415

    flags = {name: value for name, value in vars(options).items() if name in to_dict(CampaignOptions())}
    if options.start is not None:
        flags["start"] = options.start
    flags |= {"set": once("--set", options.set), "grid": once("--grid", options.grid)}
    return campaign_command.run(options.file, flags, options.out, options.workers, options.scheduler)
