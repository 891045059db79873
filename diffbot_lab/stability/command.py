"""The command ``diffbot stability``: its verbs. What they do is in modules that are imported when they are called."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from diffbot_core.ranges import LENGTH
from diffbot_lab.arguments import MAX_SEED, number_between, once, setting, whole
from diffbot_lab.stability.near_arguments import add_adversary, add_certify


def add_stability(commands: Any) -> None:
    """Add ``diffbot stability`` to the subparsers of the command line."""
    stability = commands.add_parser(
        "stability", help="what bounded noise can do to the law: certificates and a picture"
    )
    verbs = stability.add_subparsers(required=True, metavar="VERB", dest="verb")
    for add in (_add_picture, _add_level, add_certify, add_adversary, _add_verify):
        add(verbs)


def add_settings(parser: argparse.ArgumentParser) -> None:
    """Add the option ``--set`` with gains, noise and the plant."""
    parser.add_argument("--set", type=setting, nargs="+", default=[], metavar="NAME=VALUE", help="gains, noise ...")


def _add_picture(verbs: Any) -> None:
    picture = verbs.add_parser("picture", help="where V decreases on a grid of states, and what runs show")
    add_settings(picture)
    picture.add_argument("--rho-max", type=number_between(*LENGTH), default=12.0, help="size of the grid [m] (12)")
    picture.add_argument("--points", type=whole(11, 401), default=81, help="along each axis (default: %(default)s)")
    picture.add_argument("--runs", type=whole(1, 10**7), default=100_000, help="simulated (default: %(default)s)")
    picture.add_argument("--seed", type=whole(0, MAX_SEED), default=1, help="seed of their noise")
    picture.add_argument("--out", type=Path, default=Path("out/stability"), help="folder (default: %(default)s)")
    picture.set_defaults(call=_picture)


def _add_level(verbs: Any) -> None:
    level = verbs.add_parser("level", help="certify the level of V above which it decreases, for every noise")
    add_settings(level)
    level.add_argument("--rho-max", type=number_between(*LENGTH), default=12.0, help="largest distance [m] (12)")
    level.add_argument(
        "--tolerance", type=number_between(1e-4, 1.0), default=0.001, help="gap to aim at, as a share (0.001)"
    )
    level.add_argument("--seed", type=whole(0, MAX_SEED), default=1, help="seed of the search for a witness")
    level.add_argument("--out", type=Path, default=Path("out/stability/level.json"), help="file (default: %(default)s)")
    level.set_defaults(call=_level)


def _add_verify(verbs: Any) -> None:
    verify = verbs.add_parser("verify", help="check a certificate again, every cell of it")
    verify.add_argument("file", type=Path)
    verify.set_defaults(call=_verify)


def _picture(options: argparse.Namespace) -> int:
    from diffbot_lab.stability import picture_command  # noqa: PLC0415 - only the called command is imported

    values = once("--set", options.set)
    return picture_command.run(values, options.rho_max, options.points, options.runs, options.seed, options.out)


def _level(options: argparse.Namespace) -> int:
    from diffbot_lab.stability import level  # noqa: PLC0415

    values = once("--set", options.set)
    return level.run(values, options.rho_max, options.tolerance, options.seed, options.out)


def _verify(options: argparse.Namespace) -> int:
    from diffbot_lab.stability import verify_command  # noqa: PLC0415

    return verify_command.run(options.file)
