"""Bounds of the arena: the time-optimal drive, and NMPC with the true model: ``diffbot benchmark bound``.

Starts, plant, sensors, filter and noise are those of :mod:`law`: run i here has the noise of run i there.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from diffbot_control.goals.registry import resolve_law
from diffbot_core.data_sheet import DataSheet
from diffbot_core.errors import InvalidValueError
from diffbot_core.files import output_folder, write_json
from diffbot_core.geometry import Pose
from diffbot_core.schema import build, to_dict
from diffbot_lab.arena.bounds.drive import AT_THE_POSE, INTO_TOLERANCE, Target
from diffbot_lab.arena.bounds.model import load_casadi
from diffbot_lab.arena.bounds.nmpc import NmpcConfig
from diffbot_lab.arena.bounds.report import table
from diffbot_lab.arena.bounds.time import fastest_drive
from diffbot_lab.arena.cases import LIMITS, ArenaCase, arena_starts, cases_named, world_of
from diffbot_lab.arena.entries import Entry
from diffbot_lab.arena.runs import case_of
from diffbot_lab.arena.statistics import figures_of
from diffbot_lab.cases import described
from diffbot_sim.compiled.batch import HISTORY_COLUMNS
from diffbot_sim.compiled.closed_loop import buffers_for, make_loop, prepared

Array = NDArray[np.float64]

TIMED = ("nominal", "acceleration")
"""Cases with a time-optimal drive: a dead time adds itself, and the others change noise only, or are a mix."""
CASES = ("nominal", "dead_time_03", "acceleration", "mix")
LAW = "diffbot_lab.arena.bounds.nmpc:Nmpc"
_SOURCE = "J. B. Rawlings, D. Q. Mayne, M. Diehl, Model Predictive Control (2017); CasADi, Ipopt"
ENTRIES = tuple(
    Entry(f"nmpc_{feedback}", f"NMPC with the true model, {text}", LAW, _SOURCE, "a bound", feedback=feedback)
    for feedback, text in (("truth", "true pose"), ("ekf", "estimate"))
)
TARGETS = (INTO_TOLERANCE, AT_THE_POSE)


class BoundOptions(NamedTuple):
    """What is run."""

    runs: int
    """of each of the 17 starts"""
    seed: int
    """of the noise"""
    cases: tuple[str, ...] = ()
    """names among CASES; none: all"""


def run_bound(options: BoundOptions, keep: Callable[[dict[str, Any]], Any]) -> dict[str, Any]:
    """Compute the bounds, with a progress bar on a terminal.

    Args:
        options: what is run.
        keep: called with the results after each case, so that an interrupt loses one case at most.

    Raises:
        InvalidValueError: for fewer than one run or an unknown case.
        DiffbotError: if casadi is not installed.
    """
    if options.runs < 1:
        raise InvalidValueError("runs", options.runs, ">= 1")
    for name in options.cases:
        if name not in CASES:
            raise InvalidValueError("case", name, "one of " + ", ".join(CASES))
    load_casadi()
    cases = cases_named(options.cases or CASES)
    results = _conditions(options) | {"cases": []}
    starts = len(arena_starts())
    total = sum(starts * (options.runs * len(ENTRIES) + len(TARGETS) * (case.name in TIMED)) for case in cases)
    with tqdm(total=total, desc="bound", unit="run", disable=None) as bar:
        for case in cases:
            row: dict[str, Any] = {"name": case.name, "text": case.text}
            if case.name in TIMED:
                row["least_time"] = [_least_times(case, target, bar.update) for target in TARGETS]
            row["nmpc"] = [_driven(entry, case, options, bar.update) for entry in ENTRIES]
            results["cases"].append(row)
            keep(results)
    return results


def _conditions(options: BoundOptions) -> dict[str, Any]:
    """Return how the results came about."""
    command = f"diffbot benchmark bound --runs {options.runs} --seed {options.seed}"
    config = {name: value for name, value in to_dict(NmpcConfig()).items() if name not in to_dict(DataSheet())}
    return {
        "command": " ".join([command, *(f"--case {name}" for name in options.cases)]),
        "casadi": version("casadi"),
        "seed": options.seed,
        "starts": len(arena_starts()),
        "runs_of_each_start": options.runs,
        "nmpc": config,
    }


def _least_times(case: ArenaCase, target: Target, report: Callable[[], Any]) -> dict[str, Any]:
    """Return the least times [s] into a target from each start; None where the plant confirms no drive."""
    plant, _, _ = world_of(case)
    sheet = build(DataSheet, {**LIMITS, **case.sheet})
    times, guesses = [], []
    for row in arena_starts().tolist():
        found = fastest_drive(Pose(*row), plant, sheet, target)
        times.append(None if found is None else round(found.drive.time, 4))
        guesses.append(None if found is None else found.guess)
        report()
    confirmed = [one for one in times if one is not None]
    return {
        "target": target.name,
        "confirmed": len(confirmed),
        "median": float(np.median(confirmed)) if confirmed else None,
        "max": max(confirmed, default=None),
        "times": times,
        "guesses": guesses,
    }


def _driven(entry: Entry, case: ArenaCase, options: BoundOptions, report: Callable[[], Any]) -> dict[str, Any]:
    """Return the figures of NMPC in a case, with the arena's loop as plain Python: numba compiles no solver."""
    law = resolve_law(entry.law)
    shared = prepared(case_of(entry, case, {}))
    run_loop, none, starts = make_loop(law), np.empty((0, len(HISTORY_COLUMNS))), arena_starts()
    begun = time.process_time()
    outcomes = []
    for run in range(options.runs * len(starts)):
        start = Pose(*starts[run % len(starts)].tolist())
        outcomes.append(run_loop(shared, buffers_for(shared), options.seed, run, start, none))
        report()
    cost = (time.process_time() - begun) / len(outcomes)
    figures = figures_of(np.array(outcomes, dtype=np.float64))
    return {"name": entry.name, "label": entry.label, "cpu_seconds_of_a_run": round(cost, 2)} | figures


def run_and_report(options: BoundOptions, folder: Path) -> int:
    """Compute the bounds, write bound.json to ``folder`` after each case, and print the table.

    Raises:
        DiffbotError: if the folder cannot be written, a value is not allowed, or casadi is not installed.
    """
    with output_folder(folder):
        results = run_bound(options, lambda found: write_json(folder / "bound.json", found))
        for one in cases_named(options.cases or CASES):
            controller, (plant, sensors, _) = case_of(ENTRIES[0], one, {}).controller, world_of(one)
            print(described(f"{one.name}: law nmpc", controller=controller, plant=plant, sensors=sensors))
        print(table(results))
    print(f"Results in {folder}")
    return 0
