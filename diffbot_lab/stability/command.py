"""The command ``diffbot stability`` and its options.

The heavy modules are imported when a verb is called, so that the command line starts fast.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from diffbot_core.errors import InvalidValueError
from diffbot_core.files import file_path
from diffbot_tools.arguments import MAX_SEED, number_between, once, setting, whole

_BOUNDS = {
    "eps_position": (1e-6, "bound of the position error of the estimate [m] (0.06)"),
    "eps_theta": (1e-6, "bound of the heading error of the estimate [rad] (0.03)"),
    "sigma_max": (1e-6, "bound of the reported standard deviation of the position [m] (0.026)"),
    "wheel_error": (0.0, "bound of the relative error of each wheel's speed (0.05)"),
    "eps_v": (0.0, "bound of the base's position error in a step, divided by the period [m/s] (0)"),
    "eps_omega": (0.0, "bound of the error of the base's turn rate [rad/s] (0)"),
    "position_slope": (0.0, "growth of --eps-position per metre from the goal [-] (0)"),
    "theta_slope": (0.0, "growth of --eps-theta per metre from the goal [rad/m] (0)"),
    "sigma_slope": (0.0, "growth of --sigma-max per metre from the goal [-] (0)"),
}
"""Options for the bounds of a contract: smallest value and help text."""
_PLAN_OPTIONS = ("period", "margin", "fineness")
"""Options of ``certify`` that are fields of a plan."""


def add_stability(commands: Any) -> None:
    """Add ``diffbot stability`` to the subparsers of the command line."""
    stability = commands.add_parser("stability", help="certify how near the goal the robot stays in spite of noise")
    verbs = stability.add_subparsers(required=True, metavar="VERB", dest="verb")
    for add in (_add_certify, _add_verify, _add_adversary):
        add(verbs)


def _add_certify(verbs: Any) -> None:
    certify = verbs.add_parser(
        "certify", help="make a certificate of the time after which the robot stays within a distance of the goal"
    )
    certify.add_argument(
        "--robot", metavar="FILE", help="parameter file or preset; bounds that are not given are measured in simulation"
    )
    certify.add_argument(
        "--since", type=number_between(0.0, 40.0), help="with --robot: measure the bounds after this time [s] (10)"
    )
    certify.add_argument(
        "--set", type=setting, nargs="+", default=[], metavar="NAME=VALUE", help="parameters of the controller"
    )
    certify.add_argument("--rho-max", type=number_between(0.1, 100.0), help="largest distance of a start [m] (12)")
    for name, (least, text) in _BOUNDS.items():
        certify.add_argument(f"--{name.replace('_', '-')}", type=number_between(least, 0.99), help=text)
    certify.add_argument("--period", type=number_between(1e-3, 10.0), help="time between two poses [s] (0.1)")
    certify.add_argument(
        "--margin", type=number_between(0.0, 10.0), help="additional radius of the core; more is faster [m] (0.19)"
    )
    certify.add_argument(
        "--fineness", type=number_between(0.1, 10.0), help="resolution near the goal; 2 halves the size of cells (1)"
    )
    certify.add_argument("--threads", type=whole(1, 1024), help="number of threads (default: one per core)")
    certify.add_argument(
        "--out",
        type=Path,
        default=Path("out/stability/certificate.json"),
        help="file of the certificate (default: %(default)s)",
    )
    certify.set_defaults(call=_certify)


def _add_verify(verbs: Any) -> None:
    verify = verbs.add_parser("verify", help="check every cell of a certificate")
    verify.add_argument("file", type=Path, help="file of the certificate")
    verify.set_defaults(call=_verify)


def _add_adversary(verbs: Any) -> None:
    adversary = verbs.add_parser("adversary", help="attack a certificate with chosen and with random errors")
    adversary.add_argument("file", type=Path, help="file of the certificate")
    adversary.add_argument(
        "--steps", type=whole(1, 10**10), default=10**6, help="number of steps from random memories (10^6)"
    )
    adversary.add_argument("--runs", type=whole(1, 10**8), default=10**5, help="number of runs from any start (10^5)")
    adversary.add_argument(
        "--seed", type=whole(0, MAX_SEED - 1), default=1, help="seed of all errors (default: %(default)s)"
    )
    adversary.add_argument(
        "--out", type=Path, default=Path("out/stability"), help="folder of adversary.json (default: %(default)s)"
    )
    adversary.set_defaults(call=_adversary)


def _given(options: argparse.Namespace, names: Iterable[str]) -> dict[str, Any]:
    return {name: value for name in names if (value := getattr(options, name)) is not None}


def _certify(options: argparse.Namespace) -> int:
    from diffbot_control.law.configuration import SwitchingConfig  # noqa: PLC0415
    from diffbot_core.schema import build  # noqa: PLC0415
    from diffbot_lab.stability.certificates import certify_and_save, certify_robot  # noqa: PLC0415
    from diffbot_lab.stability.plan import Contract, Plan  # noqa: PLC0415

    file_path("--out", str(options.out))  # a folder is refused now, not after minutes
    bounds, cells = _given(options, _BOUNDS), _given(options, _PLAN_OPTIONS)
    if options.robot is not None:
        for name in ("set", "rho_max", "period"):
            if getattr(options, name) not in (None, []):
                raise InvalidValueError(f"--{name.replace('_', '-')}", getattr(options, name), "left out with --robot")
        since = 10.0 if options.since is None else options.since
        certify_robot(options.robot, bounds, since, cells, options.out, options.threads)
        return 0
    if options.since is not None:
        raise InvalidValueError("--since", options.since, "left out without --robot")
    if options.rho_max is not None:
        cells["to"] = options.rho_max
    plan = Plan(contract=Contract(**bounds), **cells)
    certify_and_save(build(SwitchingConfig, once("--set", options.set)), plan, options.out, options.threads)
    return 0


def _adversary(options: argparse.Namespace) -> int:
    from diffbot_lab.stability.adversary import run_adversary  # noqa: PLC0415

    return run_adversary(options.file, options.steps, options.runs, options.seed, options.out)


def _verify(options: argparse.Namespace) -> int:
    from diffbot_lab.stability.certificates import run_verify  # noqa: PLC0415

    return run_verify(options.file)
