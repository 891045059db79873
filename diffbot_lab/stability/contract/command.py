"""``diffbot stability contract``: how often estimate and base keep a contract in simulated runs."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from diffbot_control.filter.options import FilterConfig
from diffbot_control.law.controller import SwitchingLaw
from diffbot_core.errors import InvalidValueError
from diffbot_core.files import output_folder, write_json
from diffbot_lab.arena.cases import cases_named, starts_named
from diffbot_lab.arena.entries import OWN_NAME, entries_for
from diffbot_lab.arena.runs import case_of
from diffbot_lab.arena.tuning import TRAINING_SEED
from diffbot_lab.cases import Configuration, make_case
from diffbot_lab.stability.contract.deviations import ON_LEG, deviations_of
from diffbot_lab.stability.contract.kept import fitted, holds_from, kept, share_of
from diffbot_lab.stability.contract.report import table
from diffbot_lab.stability.plan import Contract, Plan, requesting
from diffbot_lab.stability.runs import uniform_starts
from diffbot_sim.compiled.batch import Starts, run_histories
from diffbot_sim.compiled.closed_loop import Case
from diffbot_tools.robot.robot import Robot

Array = NDArray[np.float64]

RUNS = {"nominal": 2040, "random_far": 1000, "coloured_05": 510, "mix": 510}
"""Cases of the arena, and the runs of each by default."""
RUNS_OF_ROBOT = 500
WINDOWS = ((3.0, 45.0), (10.0, 45.0), (15.0, 45.0), (20.0, 45.0))
"""[s] since the start, both ends included"""
SEED = 9017
"""Of noise and random starts; nothing was tuned on it."""
_DURATION = 60.0
"""[s] of a robot's run"""
_FAR = 12.0
"""[m] and seconds at full speed: a robot starts within the smaller of these distances"""
SHARE = 0.999
"""of the runs, for the bounds that are fitted in the last window"""
_CHUNK = 100
"""Runs between two steps of the progress bar; their histories are in memory."""


class Runs(NamedTuple):
    """Runs of one case."""

    name: str
    text: str
    case: Case
    starts: Array
    """(runs, 3) poses"""


def runs_of_arena(counts: dict[str, int], seed: int) -> list[Runs]:
    """Return cases of the arena with this project's law and the default filter, whichever the arena has there."""
    (entry,) = (one for one in entries_for(()) if one.name == OWN_NAME)
    return [
        Runs(
            one.name,
            one.text,
            case_of(entry, one._replace(filter=FilterConfig().filter), {}),
            starts_named(one.starts, counts[one.name], seed),
        )
        for one in cases_named(tuple(counts))
    ]


def runs_of_robot(robot: Robot, count: int, seed: int) -> Runs:
    """Return runs of a robot's own simulation to one goal.

    Raises:
        InvalidValueError: for a robot with another law, or one that finds itself by landmarks.
    """
    world, localization, supervisor, law = robot.parts(seed)
    if law is not SwitchingLaw:
        raise InvalidValueError("law", law.name, f"{SwitchingLaw.name}, for a certificate")
    if world.sensors.landmark_rate > 0.0:
        raise InvalidValueError("landmark_rate", world.sensors.landmark_rate, "0, for a contract")
    configuration = Configuration(world.plant, world.sensors, supervisor.controller, localization.filter)
    starts = uniform_starts(np.random.default_rng(seed), count, farthest_start(robot))
    case = make_case(configuration, _DURATION)._replace(history_length=localization.history_length)
    return Runs(robot.name, "as its file describes it", case, starts)


def farthest_start(robot: Robot) -> float:
    """Distance [m] within which a robot's runs and certificates start."""
    return float(min(_FAR, _FAR * robot.controller.supervisor.controller.data_sheet.v_max))


def run_contract(runs: list[Runs], contract: Contract, seed: int) -> dict[str, Any]:
    """Run all cases, with a progress bar on a terminal; return the content of results.json.

    Raises:
        InvalidValueError: for less than two runs, or the seed of the training.
    """
    if seed == TRAINING_SEED:
        raise InvalidValueError("seed", seed, "another one than that of the tuning")
    rows = []
    with tqdm(total=sum(len(one.starts) for one in runs), desc="contract", unit="run", disable=None) as bar:
        for one in runs:
            found = observe(one, contract, seed, bar)
            rows.append({"name": one.name, "text": one.text, "runs": len(one.starts)} | figures(one, found, contract))
    return {"seed": seed, "contract": contract._asdict(), "cases": rows}


def observe(runs: Runs, contract: Contract, seed: int, bar: Any = None) -> Array:
    """Run a case; return the deviations (runs, steps, 7) from its law as it requests.

    Args:
        runs: what is run.
        contract: of which only the errors of the wheels matter.
        seed: of noise.
        bar: of progress, updated by runs.
    """
    case, t_s = runs.case, runs.case.plant.sampling_time
    # Any bound of the base's motion will do: it is what is measured.
    law = requesting(case.controller, Plan(contract._replace(eps_v=0.9, eps_omega=0.9), t_s))
    found = []
    for first in range(0, len(runs.starts), _CHUNK):
        count = min(_CHUNK, len(runs.starts) - first)
        histories = run_histories(case, Starts(runs.starts), seed, first, count)
        found.append(deviations_of(case.controller, law, contract.wheel_error, t_s, histories))
        if bar is not None:
            bar.update(count)
    return np.concatenate(found)


def figures(runs: Runs, deviations: Array, contract: Contract) -> dict[str, Any]:
    """Return the share of the runs in each window, from when on the contract holds, and bounds that would hold."""
    within, t_s = kept(deviations, contract), runs.case.plant.sampling_time
    parts = [slice(round(begin / t_s), round(end / t_s) + 1) for begin, end in WINDOWS]
    since = holds_from(within, deviations[..., ON_LEG] > 0.0, t_s)
    return {
        "duration": round(within.shape[1] * t_s, 9),
        "windows": [
            {"from": begin, "to": end, **share_of(within[:, part])._asdict()}
            for (begin, end), part in zip(WINDOWS, parts, strict=True)
        ],
        "holds_from": times(since),
        "fitted": fitted(deviations[:, parts[-1]], contract, SHARE),
    }


def times(begins: Array) -> dict[str, Any]:
    """Return quantiles [s] of the times of runs (n,), None where a quantile is a run that does not end within.

    A q-quantile is the smallest time that at least a share q of the runs does not exceed.
    """
    median, p95 = np.quantile(begins, (0.5, 0.95), method="inverted_cdf").tolist()
    return {
        "median": median if math.isfinite(median) else None,
        "p95": p95 if math.isfinite(p95) else None,
        "not_at_end": int(np.isinf(begins).sum()),
    }


def run_and_report(runs: list[Runs], contract: Contract, seed: int, out: Path) -> int:
    """Write results.json to the folder ``out`` and print the tables.

    Raises:
        DiffbotError: for a bad value or an unwritable folder.
    """
    with output_folder(out):
        results = run_contract(runs, contract, seed)
        write_json(out / "results.json", results)
    print("\n".join([*table(results), "", f"{out / 'results.json'}"]))
    return 0
