"""Tune the laws, each with the same optimiser, number of evaluations and training runs: ``diffbot benchmark tune``.

The result is tuning.json, which ``diffbot benchmark switching --tuning FILE`` reads. The training runs have other noise
and other starts than the runs of the benchmark.
"""

from __future__ import annotations

from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import differential_evolution
from scipy.stats import qmc
from tqdm import tqdm

from diffbot_core.errors import InvalidValueError
from diffbot_core.files import output_folder, write_json
from diffbot_core.schema import parameters_of
from diffbot_lab.benchmark.cases import DURATION, TRAINING, cases_named
from diffbot_lab.benchmark.entries import BenchmarkLaw, entries_for
from diffbot_lab.benchmark.runs import TRAINING_SEED, run_case
from diffbot_sim.batch import COLUMNS

Array = NDArray[np.float64]

TRAINING_CASES = ("nominal", "dead_time_03", "dead_time_02_unknown", "acceleration", "mix")
RUNS = 102
"""number of runs of each case in an evaluation"""
POPULATION = 12
_TIME, _LONG_TIME, _POSITION = 12.0, 14.0, 0.05
"""[s], [s], [m] values that add 1 to the cost: median and 99 % quantile of the settling time, 95 % quantile of the
position error. A good law has a cost of about 3"""
_FAILURE, _SPIN = 20.0, 20.0
"""weights in the cost: share of the runs that do not settle, and share of the runs that turn more than _MAX_TURNING"""
_MAX_TURNING = 1.5 * 2.0 * np.pi
"""[rad] largest total turn near the goal without cost"""


def cost_of(outcomes: Array) -> float:
    """Return the cost of the outcomes of one case. The settling time of a run that does not settle is DURATION."""
    column = {name: outcomes[:, index] for index, name in enumerate(COLUMNS)}
    time = np.nan_to_num(column["settling_time"], nan=DURATION)
    position = np.hypot(column["x"], column["y"])
    figures = np.quantile(time, 0.5) / _TIME + np.quantile(time, 0.99) / _LONG_TIME
    figures += np.quantile(position, 0.95) / _POSITION
    failed = np.isnan(column["settling_time"]).mean()
    spinning = (column["turning"] > _MAX_TURNING).mean()
    return float(figures + _FAILURE * failed + _SPIN * spinning)


def tune(entry: BenchmarkLaw, budget: int) -> dict[str, Any]:
    """Tune one law with differential evolution (R. Storn, K. Price, J. Global Optimization 11, 1997).

    The first population contains the law's own values. Its other members are a Latin hypercube sample of the ranges.

    Returns:
        The best values, their cost, the cost of the law's own values, and the number of evaluations.
    """
    cases = [case._replace(starts=TRAINING) for case in cases_named(TRAINING_CASES)]
    low, high = np.array(list(entry.space.values())).T
    costs: list[float] = []

    def evaluate(x: Array) -> float:
        values = _values(entry, x)
        costs.append(float(np.mean([cost_of(run_case(entry, case, values, RUNS, TRAINING_SEED)) for case in cases])))
        bar.update()
        return costs[-1]

    defaults = {one.name: one.default for one in parameters_of(entry.law.Config)} | dict(entry.values)
    own = np.clip([float(defaults[name]) for name in entry.space], low, high)
    sample = qmc.LatinHypercube(len(own), seed=TRAINING_SEED).random(POPULATION - 1)
    with tqdm(total=budget, desc=entry.name, unit="evaluation", disable=None) as bar:
        best = differential_evolution(
            evaluate,
            list(zip(low, high, strict=True)),
            init=np.vstack([own, low + sample * (high - low)]),
            maxiter=budget // POPULATION - 1,
            tol=0.0,
            atol=0.0,
            polish=False,
            seed=TRAINING_SEED,
        )
    values, cost = _values(entry, best.x), float(best.fun)
    return {"values": values, "cost": cost, "untuned_cost": costs[0], "evaluations": len(costs)}


def _values(entry: BenchmarkLaw, x: Array) -> dict[str, float]:
    return dict(zip(entry.space, np.round(x, 6).tolist(), strict=True))


def tune_all(entries: tuple[BenchmarkLaw, ...], budget: int) -> dict[str, Any]:
    """Tune every law that has parameters to tune. Return the content of tuning.json.

    Raises:
        InvalidValueError: for a budget below one population.
    """
    if budget < POPULATION:
        raise InvalidValueError("budget", budget, f">= {POPULATION}, the size of one population")
    return {
        "optimiser": f"scipy {version('scipy')} differential_evolution, population {POPULATION}",
        "seed": TRAINING_SEED,
        "budget": budget,
        "runs_of_each_case": RUNS,
        "cases": list(TRAINING_CASES),
        "laws": {one.name: tune(one, budget) for one in entries if one.space},
    }


def run_and_report(places: tuple[str, ...], budget: int, folder: Path) -> int:
    """Tune the laws, write tuning.json to ``folder``, and print the cost of each law before and after.

    Raises:
        DiffbotError: if the folder cannot be written or a value is not allowed.
    """
    with output_folder(folder):
        tuning = tune_all(entries_for(places), budget)
        write_json(folder / "tuning.json", tuning)
    for name, one in tuning["laws"].items():
        print(f"law {name}: tuned " + ", ".join(f"{key} = {value:g}" for key, value in one["values"].items()))
        print(f"{name:<28}{one['untuned_cost']:>9.3f} -> {one['cost']:.3f}  ({one['evaluations']} evaluations)")
    print(f"Results in {folder}")
    return 0
