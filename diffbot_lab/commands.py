"""Commands of the lab on the command line; their modules are imported when they are called."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from diffbot_core.schema import to_dict
from diffbot_lab.campaign.options import CampaignOptions
from diffbot_tools.arguments import MAX_SEED, add_flags, once, setting, whole, yaml_value

RUNS_OF_EXPERIMENTS, RUNS_OF_SCAN, SEED_OF_SCAN = 100, 2000, 2
"""Defaults; the scan's seed is held out: its box was chosen on other runs."""


def add_experiment(commands: Any) -> None:
    """Add ``diffbot experiment`` to the subparsers of the command line."""
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
    campaign.add_argument("--out", type=Path, default=Path("out/campaign"), help="folder (default: %(default)s)")
    campaign.add_argument("--workers", type=whole(1, 1024), help="processes (default: one per core)")
    campaign.add_argument(
        "--scheduler", metavar="ADDRESS", help="run on a dask.distributed cluster, e.g. tcp://host:8786"
    )
    campaign.set_defaults(call=_campaign)


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
