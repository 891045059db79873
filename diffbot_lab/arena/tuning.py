"""Tuning of the laws: each with the same number of evaluations of the same optimiser on the same training runs.

``diffbot benchmark tune`` writes tuning.json, which ``diffbot benchmark switching --tuning FILE`` reads. The noise and
the starts of the training are not those on which the laws are compared.
"""

from __future__ import annotations

import functools
import json
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import differential_evolution
from scipy.stats import qmc
from tqdm import tqdm

from diffbot_control.goals.registry import resolve_law
from diffbot_core.errors import DiffbotError, InvalidValueError
from diffbot_core.files import output_folder, write_json
from diffbot_core.schema import parameters_of
from diffbot_lab.arena.cases import DURATION, TRAINING, ArenaCase, Values, cases_named
from diffbot_lab.arena.entries import Entry, entries_for
from diffbot_lab.arena.runs import run_case
from diffbot_sim.compiled.batch import COLUMNS

Array = NDArray[np.float64]

TRAINING_CASES = ("nominal", "dead_time_03", "dead_time_02_unknown", "acceleration", "mix")
TRAINING_SEED = 1_000_003
"""Of noise, starts and optimiser; no seed of a comparison may equal it."""
POPULATION = 12
KEPT = Path(__file__).with_name("tuning.json")
"""Result of the last tuning, installed with the package."""
_TIME, _LONG_TIME, _POSITION = 12.0, 14.0, 0.05
"""[s], [s], [m] by which median, 99 % and 95 % of the position error are divided: a good law costs about 3."""
_FAILURE, _SPIN = 20.0, 20.0
"""Cost of the share of runs that do not settle, and of those that turn too much near the goal."""
_MAX_TURNING = 1.5 * 2.0 * np.pi


def cost_of(outcomes: Array) -> float:
    """Return the cost of one case's outcomes; a run that does not settle counts as one of the full duration."""
    column = {name: outcomes[:, index] for index, name in enumerate(COLUMNS)}
    time = np.nan_to_num(column["settling_time"], nan=DURATION)
    position = np.hypot(column["x"], column["y"])
    figures = np.quantile(time, 0.5) / _TIME + np.quantile(time, 0.99) / _LONG_TIME
    figures += np.quantile(position, 0.95) / _POSITION
    failed = np.isnan(column["settling_time"]).mean()
    spinning = (column["turning"] > _MAX_TURNING).mean()
    return float(figures + _FAILURE * failed + _SPIN * spinning)


def tune(entry: Entry, cases: tuple[ArenaCase, ...], budget: int, runs: int, seed: int) -> dict[str, Any]:
    """Tune one law with differential evolution (R. Storn, K. Price, J. Global Optimization 11, 1997).

    The law's own values are one member of the first population; the others are a Latin hypercube of its ranges.

    Returns:
        The best values, their cost, that of the law's own values, and the number of evaluations.
    """
    names = list(entry.space)
    low, high = np.array([entry.space[name] for name in names]).T
    evaluate = functools.partial(_evaluate, entry, cases, runs, seed)
    own = np.clip(_own_values(entry, names), low, high)
    sample = qmc.LatinHypercube(len(names), seed=seed).random(POPULATION - 1)
    first = np.vstack([own, low + sample * (high - low)])
    with tqdm(total=budget, desc=entry.name, unit="evaluation", disable=None) as bar:
        counted = _Counted(lambda x: evaluate(_values(names, x)), bar.update)
        found = differential_evolution(
            counted,
            list(zip(low, high, strict=True)),
            init=first,
            maxiter=max(budget // POPULATION - 1, 0),
            tol=0.0,
            atol=0.0,
            polish=False,
            seed=seed,
        )
    return {
        "values": _values(names, found.x),
        "cost": float(found.fun),
        "untuned_cost": counted.first,
        "evaluations": counted.number,
    }


class _Counted:
    """A cost function that counts its calls and keeps the first value."""

    def __init__(self, function: Callable[[Array], float], report: Callable[[], Any]) -> None:
        self._function, self._report = function, report
        self.number, self.first = 0, float("nan")

    def __call__(self, x: Array) -> float:
        value = self._function(x)
        if self.number == 0:
            self.first = value
        self.number += 1
        self._report()
        return value


def _values(names: list[str], x: Array) -> dict[str, float]:
    return dict(zip(names, np.round(x, 6).tolist(), strict=True))


def _own_values(entry: Entry, names: list[str]) -> Array:

    defaults = {one.name: one.default for one in parameters_of(resolve_law(entry.law).Config)}
    return np.array([float({**defaults, **entry.values}[name]) for name in names])


def _evaluate(entry: Entry, cases: tuple[ArenaCase, ...], runs: int, seed: int, values: Values) -> float:
    costs = [cost_of(run_case(entry, case._replace(starts=TRAINING), values, runs, seed)) for case in cases]
    return float(np.mean(costs))


def tune_all(entries: tuple[Entry, ...], budget: int, runs: int, cases: tuple[str, ...]) -> dict[str, Any]:
    """Tune every law that has something to tune; return the content of tuning.json.

    Raises:
        InvalidValueError: for a budget below one population.
    """
    if budget < POPULATION:
        raise InvalidValueError("budget", budget, f">= {POPULATION}, one population")
    names = cases or TRAINING_CASES
    chosen = cases_named(names)
    return {
        "optimiser": f"scipy {version('scipy')} differential_evolution, population {POPULATION}",
        "seed": TRAINING_SEED,
        "budget": budget,
        "runs_of_each_case": runs,
        "cases": list(names),
        "laws": {one.name: tune(one, chosen, budget, runs, TRAINING_SEED) for one in entries if one.space},
    }


def read_tuning(path: Path | None) -> dict[str, Any]:
    """Return the content of a tuning.json; None: the one installed with the package, or nothing tuned.

    Raises:
        DiffbotError: if it cannot be read, or is none.
    """
    if path is None and not KEPT.exists():
        return {"laws": {}}
    try:
        content: dict[str, Any] = json.loads((path or KEPT).read_text())
    except OSError as error:
        raise DiffbotError(f"cannot read {path or KEPT}: {error.strerror}") from None
    except ValueError:
        raise DiffbotError(f"{path or KEPT} is no JSON") from None
    if not isinstance(content, dict) or not isinstance(content.get("laws"), dict):
        raise DiffbotError(f"{path or KEPT} is no result of diffbot benchmark tune")
    return content


def tuned_values(tuning: dict[str, Any], entry: Entry) -> dict[str, Any]:
    """Return the tuned values of a law, none if it was not tuned; checked against its ranges."""
    values = tuning["laws"].get(entry.name, {}).get("values", {})
    for name in values:
        if name not in entry.space:
            raise InvalidValueError(f"tuning of {entry.name}", name, "one of " + (", ".join(entry.space) or "none"))
    return dict(values)


def run_and_report(places: tuple[str, ...], budget: int, runs: int, cases: tuple[str, ...], folder: Path) -> int:
    """Tune, write tuning.json to ``folder``, and print what was gained.

    Raises:
        DiffbotError: if the folder cannot be written or a value is not allowed.
    """
    with output_folder(folder):
        tuning = tune_all(entries_for(places), budget, runs, cases)
        write_json(folder / "tuning.json", tuning)
    for name, one in tuning["laws"].items():
        print(f"law {name}: tuned " + ", ".join(f"{key} = {value:g}" for key, value in one["values"].items()))
        print(f"{name:<28}{one['untuned_cost']:>9.3f} -> {one['cost']:.3f}  ({one['evaluations']} evaluations)")
    print(f"Results in {folder}")
    return 0
