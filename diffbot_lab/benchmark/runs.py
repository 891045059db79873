"""Run all laws under equal conditions: ``diffbot benchmark switching``.

Run i has the same start and the same noise for every law. All laws have the same limits and the same data sheet. The
peers were tuned with the same budget, with other starts and other noise (:mod:`.tuning`).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from diffbot_control.law.registry import TUNED
from diffbot_core.errors import InvalidValueError
from diffbot_lab.benchmark import cases
from diffbot_lab.benchmark.cases import BenchmarkCase, Values
from diffbot_lab.benchmark.entries import (
    OWN_NAME,
    TUNING,
    BenchmarkLaw,
    config_of,
    entries_for,
    is_run,
    read_tuning,
    tuned_values,
)
from diffbot_lab.benchmark.statistics import figures_of
from diffbot_lab.cases import Configuration, changes, make_case
from diffbot_sim.batch import Starts, run_batch, run_histories
from diffbot_sim.robot_step import Case

Array = NDArray[np.float64]

NOMINAL = "nominal"
TRAINING_SEED = 1_000_003
"""Seed of noise, starts and optimiser of the tuning. The benchmark refuses this seed."""


class BenchmarkOptions(NamedTuple):
    """Options of ``diffbot benchmark switching``."""

    runs: int
    """number of runs from each of the 17 starts; a case with random starts has 17 times as many runs"""
    seed: int
    """seed of noise and random starts"""
    laws: tuple[str, ...] = ()
    """peers, see :func:`entries_for`; empty for all entries"""
    cases: tuple[str, ...] = ()
    """names of cases; empty for all cases"""
    tuning: Path = TUNING
    own_runs: int = 0
    """number of runs from each start for this project's law, if it is larger than ``runs``; narrows the intervals"""

    def runs_of(self, entry: BenchmarkLaw) -> int:
        """Return the number of runs of a law in a case."""
        runs = max(self.runs, self.own_runs) if entry.name == OWN_NAME else self.runs
        return runs * len(cases.arena_starts())


def case_of(entry: BenchmarkLaw, case: BenchmarkCase, tuned: Values) -> Case:
    """Return the simulation case of a law in a case of the benchmark."""
    plant, sensors, filter_config = cases.world_of(case)
    return make_case(
        Configuration(plant, sensors, config_of(entry, case, tuned), filter_config),
        cases.DURATION,
        law=entry.law,
        tolerance=(case.xy_tolerance, cases.YAW_TOLERANCE),
    )


def run_case(entry: BenchmarkLaw, case: BenchmarkCase, tuned: Values, count: int, seed: int, drawn: int = 0) -> Array:
    """Return the outcomes (count, 12) of runs, columns as batch.COLUMNS.

    Args:
        entry: the law.
        case: the case.
        tuned: tuned values, which replace the values of the entry.
        count: number of runs.
        seed: seed of noise and random starts.
        drawn: number of random starts to draw, if larger than ``count``; the runs use the first ones. Random starts
            depend on this number, so it has to be equal for all laws.
    """
    starts = Starts(cases.starts_named(case.starts, max(count, drawn), seed)[:count])
    return run_batch(case_of(entry, case, tuned), starts, seed, 0, count, law=entry.law)


def run_paths(entry: BenchmarkLaw, case: BenchmarkCase, tuned: Values, start: Array, count: int, seed: int) -> Array:
    """Return the histories (count, steps + 1, 12) of runs from one start (3,)."""
    starts = Starts(start[np.newaxis])
    return run_histories(case_of(entry, case, tuned), starts, seed, 0, count, law=entry.law)


def run_benchmark(options: BenchmarkOptions) -> tuple[dict[str, Any], dict[str, Array]]:
    """Run all laws in all cases. On a terminal, show a progress bar.

    Returns:
        The content of results.json without the list of peers that are ahead, and the outcomes in the nominal case by
        the name of the law.

    Raises:
        InvalidValueError: for the seed of the tuning, or an unknown law or case.
    """
    if options.seed == TRAINING_SEED:
        raise InvalidValueError("seed", options.seed, sentence="the laws were tuned with this seed; choose another one")
    entries, chosen = entries_for(options.laws), cases.cases_named(options.cases)
    tuning = read_tuning(options.tuning)
    tuned = {entry.name: tuned_values(tuning, entry) for entry in entries}
    pairs = [(case, entry) for case in chosen for entry in entries if is_run(entry, case)]
    for case, entry in pairs:
        config_of(entry, case, tuned[entry.name])  # checks all values before the first run
    outcomes: dict[str, Array] = {}
    laws: dict[str, list[dict[str, Any]]] = {case.name: [] for case in chosen}
    for case, entry in tqdm(pairs, desc="benchmark", unit="law", disable=None):
        count, drawn = options.runs_of(entry), options.runs_of(entries[0])
        result = run_case(entry, case, tuned[entry.name], count, options.seed, drawn)
        if case.name == NOMINAL:
            outcomes[entry.name] = result
        laws[case.name].append({"name": entry.name} | figures_of(result))
    results = {
        "runs_of_each_start": options.runs,
        "own_runs_of_each_start": max(options.runs, options.own_runs),
        "starts": len(cases.arena_starts()),
        "seed": options.seed,
        "duration": cases.DURATION,
        "xy_tolerance": cases.XY_TOLERANCE,
        "yaw_tolerance": cases.YAW_TOLERANCE,
        "limits": dict(cases.LIMITS),
        "tuning": tuning,
        "cases": [{"name": one.name, "text": one.text, "table": one.table, "laws": laws[one.name]} for one in chosen],
        "laws": [_described(entry, config_of(entry, chosen[0], tuned[entry.name])) for entry in entries],
    }
    return results, outcomes


def _described(entry: BenchmarkLaw, config: Any) -> dict[str, Any]:
    law = f"{entry.law.name}, preset {TUNED}" if entry.name == OWN_NAME else entry.law.name
    text = f"law {law}; {changes(config)}"
    return {"parameters": text, "name": entry.name, "label": entry.label, "source": entry.source}
