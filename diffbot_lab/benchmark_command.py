"""Command line of ``diffbot benchmark``."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from diffbot_core.errors import DiffbotError
from diffbot_tools.arguments import MAX_SEED, whole

REAL = "real"
PEER = "robot_localization"
BENCHMARKS = {
    "switching": (100, Path("out/benchmark")),
    "localization": (200, Path("out/localization")),
    "colour": (400, Path("out/colour")),
    "states": (40, Path("out/states")),
    "effects": (60, Path("out/effects")),
    "tune": (102, Path("out/tuning")),
    "animate": (200, Path("out/animation")),
    "bound": (2, Path("out/bound")),
    "docking": (17_000, Path("out/docking")),
    "calibration": (40, Path("out/calibration")),
    REAL: (1, Path("out/real")),
    PEER: (20, Path("out/robot_localization")),
}
"""Default number of runs, default folder."""


def add_benchmark(commands: Any) -> None:
    """Add ``diffbot benchmark`` to the subparsers of the command line."""
    benchmark = commands.add_parser(
        "benchmark",
        help="the law and its peers, their tuning, bounds or picture; docking; the filter, simulated, on real drives, "
        "or beside robot_localization; calibration",
    )
    benchmark.add_argument(
        "what", nargs="?", choices=tuple(BENCHMARKS), default="switching", help="%(default)s if none"
    )
    benchmark.add_argument("folder", type=Path, nargs="?", help="real: folder of a data set (docs/how-to/real-data.md)")
    benchmark.add_argument(
        "--runs",
        type=whole(1, 10**5),
        help="switching: of each start (default: 100); localization: of each case (default: 200); "
        "tune: of each case in an evaluation (default: 102); animate: the most typical one of these (default: 200); "
        "colour: drives at each correlation (default: 400); states: drives (default: 40); "
        "effects: of each start (default: 60); bound: of each start (default: 2); "
        "docking: of each law in each case (default: 17000); calibration: drives (default: 40); "
        "robot_localization: drives of each case (default: 20)",
    )
    benchmark.add_argument(
        "--own-runs",
        type=whole(1, 10**5),
        default=1,
        help="switching: runs of each start for this project's law alone",
    )
    benchmark.add_argument("--seed", type=whole(0, MAX_SEED), default=1, help="seed of all noise")
    benchmark.add_argument("--out", type=Path, help="folder (default: out/benchmark, out/localization, ...)")
    _add_choices(benchmark)
    benchmark.set_defaults(call=_benchmark)


def _add_choices(benchmark: argparse.ArgumentParser) -> None:
    """Add the arguments that choose a part of a benchmark."""
    benchmark.add_argument(
        "--law",
        action="append",
        default=[],
        metavar="LAW",
        help="compare the switching law with this one alone: a name, or package.module:Class; may be repeated",
    )
    benchmark.add_argument("--case", action="append", default=[], help="run this case alone; may be repeated")
    benchmark.add_argument("--tuning", type=Path, metavar="FILE", help="tuning.json of diffbot benchmark tune")
    benchmark.add_argument(
        "--budget", type=whole(1, 10**6), default=480, help="tune: evaluations for each law (default: %(default)s)"
    )
    benchmark.add_argument(
        "--calibrate", action="store_true", help="real: calibrate on the first third of each drive, too"
    )
    benchmark.add_argument(
        "--runner", type=Path, metavar="FILE", help="robot_localization: the program of bench/robot_localization"
    )
    benchmark.add_argument("--no-figures", dest="figures", action="store_false", help="results.json and table only")


def _benchmark(options: argparse.Namespace) -> int:
    if (options.what == REAL) != (options.folder is not None):
        raise DiffbotError(f"benchmark: {REAL} needs the folder of a data set, the others take none")
    if (options.what == PEER) != (options.runner is not None):
        raise DiffbotError(f"benchmark: {PEER} needs --runner, the others take none")
    number, folder = BENCHMARKS[options.what]
    return _CALLS[options.what](options, options.runs or number, options.out or folder)


def _switching(options: argparse.Namespace, runs: int, out: Path) -> int:
    from diffbot_lab.arena import command as law  # noqa: PLC0415

    laws, cases = tuple(options.law), tuple(options.case)
    arena = law.ArenaOptions(runs, options.seed, laws, cases, options.tuning, options.own_runs)
    return law.run_and_report(arena, out, options.figures)


def _localization(options: argparse.Namespace, runs: int, out: Path) -> int:
    from diffbot_lab.filter_benchmark import command as filter_benchmark  # noqa: PLC0415

    return filter_benchmark.run_and_report(runs, options.seed, out, options.figures)


def _colour(options: argparse.Namespace, runs: int, out: Path) -> int:
    from diffbot_lab.filter_benchmark import colour as filter_colour  # noqa: PLC0415

    return filter_colour.run_and_report(runs, options.seed, out)


def _states(options: argparse.Namespace, runs: int, out: Path) -> int:
    from diffbot_lab.filter_benchmark import states as filter_states  # noqa: PLC0415

    return filter_states.run_and_report(runs, options.seed, out)


def _effects(options: argparse.Namespace, runs: int, out: Path) -> int:
    from diffbot_lab.arena import effects as law_effects  # noqa: PLC0415

    return law_effects.run_and_report(runs, options.seed, out)


def _tune(options: argparse.Namespace, runs: int, out: Path) -> int:
    from diffbot_lab.arena import tuning as law_tuning  # noqa: PLC0415

    return law_tuning.run_and_report(tuple(options.law), options.budget, runs, tuple(options.case), out)


def _animate(options: argparse.Namespace, runs: int, out: Path) -> int:
    from diffbot_lab.arena import animation as law_animation  # noqa: PLC0415

    shown = law_animation.AnimationOptions(runs, options.seed, tuple(options.law), options.tuning)
    return law_animation.run_and_report(shown, out)


def _bound(options: argparse.Namespace, runs: int, out: Path) -> int:
    from diffbot_lab.arena.bounds import command as bound  # noqa: PLC0415

    return bound.run_and_report(bound.BoundOptions(runs, options.seed, tuple(options.case)), out)


def _docking(options: argparse.Namespace, runs: int, out: Path) -> int:
    from diffbot_lab.arena.docking import report as docking  # noqa: PLC0415

    return docking.run_and_report(runs, options.seed, tuple(options.case), out, options.figures)


def _real(options: argparse.Namespace, runs: int, out: Path) -> int:
    from diffbot_lab.filter_benchmark import real_command as benchmark  # noqa: PLC0415

    return benchmark.run_and_report(options.folder, out, options.figures, calibrated=options.calibrate)


def _peer(options: argparse.Namespace, runs: int, out: Path) -> int:
    from diffbot_lab.filter_benchmark import peer  # noqa: PLC0415

    return peer.run_and_report(options.runner.resolve(), runs, options.seed, tuple(options.case), out)


def _calibration(options: argparse.Namespace, runs: int, out: Path) -> int:
    from diffbot_lab.filter_benchmark import calibration as benchmark  # noqa: PLC0415

    return benchmark.run_and_report(runs, options.seed, out)


_CALLS = {
    "switching": _switching,
    "localization": _localization,
    "colour": _colour,
    "states": _states,
    "effects": _effects,
    "tune": _tune,
    "animate": _animate,
    "bound": _bound,
    "docking": _docking,
    "calibration": _calibration,
    REAL: _real,
    PEER: _peer,
}
