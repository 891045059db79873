"""``diffbot stability contract``: how often the default filter keeps the contract in the closed loop."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from diffbot_control.filter.options import FilterConfig
from diffbot_core.errors import InvalidValueError
from diffbot_core.files import output_folder, write_json
from diffbot_lab.arena.cases import ArenaCase, cases_named, starts_named
from diffbot_lab.arena.entries import OWN_NAME, entries_for
from diffbot_lab.arena.runs import case_of
from diffbot_lab.arena.tuning import TRAINING_SEED
from diffbot_lab.stability.contract.kept import Mask, errors_within, holds_from, shares
from diffbot_lab.stability.contract.report import table
from diffbot_lab.stability.tuned.contract import Contract
from diffbot_sim.compiled.batch import HISTORY_COLUMNS, Starts, run_histories

RUNS = {"nominal": 2040, "random_far": 1000, "coloured_05": 510, "mix": 510}
"""Cases of the arena, and the runs of each by default."""
WINDOWS = ((5.0, 10.0), (10.0, 45.0), (15.0, 45.0), (20.0, 45.0))
"""[s] since the start, both ends included"""
SEED = 9017
"""Of noise and random starts; nothing was tuned on it."""
_CHUNK = 100
"""Runs between two steps of the progress bar; their histories are in memory."""
_SIGMA = HISTORY_COLUMNS.index("sigma")


class Observed(NamedTuple):
    """Where a contract is kept, (runs, steps) from time 0 on."""

    errors: Mask
    """position and heading are within their bounds"""
    sigma: Mask
    """the reported standard deviation is"""
    sampling_time: float
    """[s]"""


def run_contract(contract: Contract, seed: int = SEED, runs: int | None = None) -> dict[str, Any]:
    """Run all cases, with a progress bar on a terminal; return the content of results.json.

    Args:
        contract: whose bounds are looked at.
        seed: of noise and random starts.
        runs: of each case; None for RUNS.

    Raises:
        InvalidValueError: for less than two runs, or the seed of the training.
    """
    if runs is not None and runs < 2:
        raise InvalidValueError("runs", runs, ">= 2")
    if seed == TRAINING_SEED:
        raise InvalidValueError("seed", seed, "another one than that of the tuning")
    counts = {name: runs or count for name, count in RUNS.items()}
    rows = []
    with tqdm(total=sum(counts.values()), desc="contract", unit="run", disable=None) as bar:
        for case in cases_named(tuple(counts)):
            observed = observe(case, counts[case.name], seed, contract, bar)
            rows.append({"name": case.name, "text": case.text, "runs": counts[case.name]} | figures(observed))
    return {
        "seed": seed,
        "filter": FilterConfig().filter,
        "contract": contract._asdict(),
        "cases": rows,
    }


def observe(case: ArenaCase, runs: int, seed: int, contract: Contract, bar: Any = None) -> Observed:
    """Run a case with this project's law and the default filter, whichever the arena has there.

    Args:
        case: of the arena.
        runs: how many.
        seed: of noise and random starts.
        contract: whose bounds are looked at.
        bar: of progress, updated by runs.
    """
    (entry,) = (one for one in entries_for(()) if one.name == OWN_NAME)
    shared = case_of(entry, case._replace(filter=FilterConfig().filter), {})
    starts = Starts(starts_named(case.starts, runs, seed))
    errors, sigma = [], []
    for first in range(0, runs, _CHUNK):
        histories = run_histories(shared, starts, seed, first, min(_CHUNK, runs - first))
        errors.append(errors_within(errors_of(histories), contract))
        sigma.append(histories[..., _SIGMA] <= contract.sigma_max)
        if bar is not None:
            bar.update(len(histories))
    return Observed(np.concatenate(errors), np.concatenate(sigma), shared.plant.sampling_time)


def errors_of(histories: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return estimated minus true pose of histories (..., 9), (..., 3) [m, m, rad], the heading's wrapped."""
    errors: NDArray[np.float64] = histories[..., 3:6] - histories[..., :3]
    errors[..., 2] = np.remainder(errors[..., 2] + math.pi, 2.0 * math.pi) - math.pi
    return errors


def figures(observed: Observed) -> dict[str, Any]:
    """Return shares in each window, and the times from which the contract holds."""
    errors, sigma, t_s = observed
    windows = []
    for begin, end in WINDOWS:
        part = slice(round(begin / t_s), round(end / t_s) + 1)
        masks = {"errors": errors[:, part], "sigma": sigma[:, part], "all": errors[:, part] & sigma[:, part]}
        windows.append({"from": begin, "to": end, **{name: shares(mask)._asdict() for name, mask in masks.items()}})
    return {
        "duration": round((errors.shape[1] - 1) * t_s, 9),
        "windows": windows,
        "errors_hold_from": times(holds_from(errors, t_s)),
        "all_hold_from": times(holds_from(errors & sigma, t_s)),
    }


def times(begins: NDArray[np.float64]) -> dict[str, Any]:
    """Return quantiles [s] of the times of runs (n,), None where a quantile is a run that does not end within.

    A q-quantile is the smallest time that at least a share q of the runs does not exceed.
    """
    median, p95 = np.quantile(begins, (0.5, 0.95), method="inverted_cdf").tolist()
    return {
        "median": median if math.isfinite(median) else None,
        "p95": p95 if math.isfinite(p95) else None,
        "not_at_end": int(np.isinf(begins).sum()),
    }


def run_and_report(contract: Contract, seed: int, runs: int | None, out: Path) -> int:
    """Write results.json to the folder ``out`` and print the tables.

    Raises:
        DiffbotError: for a bad value or an unwritable folder.
    """
    with output_folder(out):
        results = run_contract(contract, seed, runs)
        write_json(out / "results.json", results)
    print("\n".join([*table(results), "", f"{out / 'results.json'}"]))
    return 0
