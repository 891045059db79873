"""Command lines of ``diffbot stability certify`` and ``diffbot stability adversary``."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from diffbot_lab.arguments import MAX_SEED, number_between, once, setting, whole

_WIDTH, _COLUMNS = 0.0025, 1256


def add_certify(verbs: Any) -> None:
    """Add the verb to the subparsers of ``diffbot stability``."""
    certify = verbs.add_parser("certify", help="certify where the noisy loop ends, and after what time at most")
    certify.add_argument("--law", choices=("13", "17"), default="17", help="equation (default: %(default)s)")
    certify.add_argument("--set", type=setting, nargs="+", default=[], metavar="NAME=VALUE", help="gains, noise ...")
    certify.add_argument("--rho-max", type=number_between(0.1, 100.0), default=12.0, help="starts are within [m] (12)")
    certify.add_argument(
        "--width", type=number_between(1e-4, 1.0), default=_WIDTH, help="of the cells near the goal [m] (%(default)s)"
    )
    certify.add_argument("--columns", type=whole(16, 16_000), default=_COLUMNS, help="cells of alpha (%(default)s)")
    certify.add_argument("--threads", type=whole(1, 1024), help="at a time (default: one per core)")
    certify.add_argument(
        "--out", type=Path, default=Path("out/stability/certificate.json"), help="file (default: %(default)s)"
    )
    certify.set_defaults(call=_certify)


def add_adversary(verbs: Any) -> None:
    """Add the verb to the subparsers of ``diffbot stability``."""
    adversary = verbs.add_parser("adversary", help="attack a certificate: chosen noise, and many runs of random noise")
    adversary.add_argument("file", type=Path, help="certificate")
    adversary.add_argument("--steps", type=whole(1, 10**10), default=10**6, help="of random noise from the core (10^6)")
    adversary.add_argument("--runs", type=whole(1, 10**8), default=10**5, help="from all over the start (10^5)")
    adversary.add_argument("--seed", type=whole(0, MAX_SEED - 1), default=1, help="of all noise (default: %(default)s)")
    adversary.add_argument("--out", type=Path, default=Path("out/stability"), help="folder (default: %(default)s)")
    adversary.set_defaults(call=_adversary)


def _certify(options: argparse.Namespace) -> int:
    from diffbot_lab.stability import near_commands  # noqa: PLC0415 - only the called command is imported

    loop = near_commands.loop_of(options.law, once("--set", options.set))
    resolution = near_commands.Resolution(width=options.width, columns=options.columns)
    return near_commands.run_certify(loop, options.rho_max, resolution, options.out, options.threads)


def _adversary(options: argparse.Namespace) -> int:
    from diffbot_lab.stability import near_commands  # noqa: PLC0415

    return near_commands.run_adversary(options.file, options.steps, options.runs, options.seed, options.out)
