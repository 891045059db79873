"""This project's filter beside that of robot_localization: ``diffbot benchmark robot_localization``.

Both get the same messages of the simulated robot, in the order of arrival. The peer is its own code, run by
bench/robot_localization; its process noise and its gate are tuned for each case on other drives, while this project's
filter has its defaults.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy import stats
from tqdm import tqdm

from diffbot_core.errors import DiffbotError, InvalidValueError
from diffbot_core.files import output_folder, write_json
from diffbot_lab.cases import described
from diffbot_lab.filter_benchmark.peer_drives import CASES, DURATION, RATE, Drive, PeerCase, record_drive
from diffbot_lab.filter_benchmark.peer_filters import Estimates, PeerNoise, run_ours, run_peer
from diffbot_lab.filter_benchmark.peer_report import table

Results = dict[str, Any]

OURS, DEFAULT, TUNED = "diffbot", "default", "tuned"
SKIPPED = 30.0
"""[s] at the start of a drive that do not count"""
TRAINING_SEEDS = (1001, 1002)
"""of the drives that the peer is tuned on"""
_BEGIN = PeerNoise(1e-4, 1e-4, 0.5, 0.5, 1e9)
_SWEEPS = 2
_GRIDS = (
    ("gate", (4.0, 8.0)),
    ("yaw", (1e-5, 1e-3)),
    ("position", (1e-5, 1e-3, 1e-2)),
    ("omega", (0.05, 5.0)),
    ("v", (0.05, 5.0)),
)
"""What is tried one after the other, the best kept, in each of the sweeps: the budget of the peer."""


class Errors(NamedTuple):
    """Figures of a filter on one drive."""

    position: float
    """[m] root mean square"""
    heading: float
    """[rad] root mean square"""
    nees: float
    """mean"""
    cpu: float
    """[s] of the process for each message of the odometry"""


def errors_of(estimates: Estimates, drive: Drive, skipped: float = SKIPPED) -> Errors:
    """Compare estimates with the truth at their stamps; the first ``skipped`` seconds do not count."""
    counts = (estimates.steps >= skipped * RATE) & (estimates.steps < len(drive.truth))
    error = estimates.poses[counts] - drive.truth[estimates.steps[counts]]
    error[:, 2] = np.remainder(error[:, 2] + math.pi, 2.0 * math.pi) - math.pi
    P = estimates.P[counts]
    nees = np.einsum("ni,ni->n", error, np.linalg.solve(P, error[..., np.newaxis])[..., 0])
    return Errors(
        math.sqrt(float((error[:, :2] ** 2).sum(axis=1).mean())),
        math.sqrt(float((error[:, 2] ** 2).mean())),
        float(nees.mean()),
        estimates.cpu / len(drive.truth),
    )


def tuned(runner: Path, duration: float, case: PeerCase) -> PeerNoise:
    """Search the peer's noise and gate, one number after the other, for the least error on the training drives."""
    drives = [record_drive(case, seed, duration) for seed in TRAINING_SEEDS]

    def cost(noise: PeerNoise) -> float:
        found = [errors_of(run_peer(runner, case, drive, noise)[0], drive) for drive in drives]
        return sum(one.position + 0.3 * one.heading for one in found)

    return _searched(cost)


def _searched(cost: Callable[[PeerNoise], float]) -> PeerNoise:
    best, least = _BEGIN, cost(_BEGIN)
    for name, values in _GRIDS * _SWEEPS:
        for value in values:
            tried = best._replace(**{name: value})
            if (costs := cost(tried)) < least:
                best, least = tried, costs
    return best


def compared(runner: Path, duration: float, job: tuple[PeerCase, int, PeerNoise]) -> tuple[dict[str, Errors], str]:
    """Run all filters on one drive; return also the peer's version."""
    case, seed, noise = job
    drive = record_drive(case, seed, duration)
    found = {OURS: errors_of(run_ours(case, drive), drive)}
    version = ""
    for name, setting in ((DEFAULT, None), (TUNED, noise)):
        estimates, version = run_peer(runner, case, drive, setting)
        found[name] = errors_of(estimates, drive)
    return found, version


def interval_of(values: list[float]) -> list[float]:
    """Return the mean and its 95 % interval, by Student's t."""
    mean = float(np.mean(values))
    if len(values) < 2:
        return [mean, -math.inf, math.inf]
    half = float(stats.t.ppf(0.975, len(values) - 1) * stats.sem(values))
    return [mean, mean - half, mean + half]


def ratio_of(ours: list[float], peers: list[float]) -> list[float]:
    """Return the geometric mean of ours over the peer's on the same drives, with its 95 % interval."""
    logs = [math.log(a / b) for a, b in zip(ours, peers, strict=True)]
    return [math.exp(one) for one in interval_of(logs)]


def figures_of(case: PeerCase, noise: PeerNoise, found: list[dict[str, Errors]]) -> Results:
    """Return the figures of one case."""
    columns = {name: [one[name] for one in found] for name in found[0]}
    return {
        "name": case.name,
        "text": case.text,
        "noise": noise._asdict(),
        "filters": {
            name: {field: interval_of([getattr(one, field) for one in errors]) for field in Errors._fields}
            for name, errors in columns.items()
        },
        "ratio": {
            field: ratio_of(*([getattr(one, field) for one in columns[name]] for name in (OURS, TUNED)))
            for field in ("position", "heading")
        },
    }


def run_benchmark(
    runner: Path, runs: int, seed: int, names: tuple[str, ...] = (), duration: float = DURATION
) -> Results:
    """Tune the peer, then compare, with a progress bar on a terminal; return the content of results.json.

    Args:
        runner: executable of bench/robot_localization.
        runs: drives of each case.
        seed: of the first drive.
        names: of the cases; none for all.
        duration: [s] of a drive.

    Raises:
        InvalidValueError: for an unknown case, or a seed that the peer is tuned on.
        DiffbotError: if the runner fails.
    """
    known = {case.name: case for case in CASES}
    for name in names:
        if name not in known:
            raise InvalidValueError("case", name, "one of " + ", ".join(known))
    seeds = range(seed, seed + runs)
    if set(seeds) & set(TRAINING_SEEDS):
        raise InvalidValueError("seed", seed, f"such that no drive has one of the training seeds {TRAINING_SEEDS}")
    cases = [known[name] for name in names or known]
    with ProcessPoolExecutor(os.cpu_count(), mp_context=get_context("spawn")) as pool:
        try:
            tunings = pool.map(partial(tuned, runner, duration), cases)
            noises = list(tqdm(tunings, desc="tuning", total=len(cases), unit="case", disable=None))
            jobs = [(case, one, noise) for case, noise in zip(cases, noises, strict=True) for one in seeds]
            results = pool.map(partial(compared, runner, duration), jobs)
            done = list(tqdm(results, desc="benchmark", total=len(jobs), unit="drive", disable=None))
        except (KeyboardInterrupt, DiffbotError):
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return {
        "peer": f"robot_localization {done[0][1]}",
        "runs": runs,
        "seed": seed,
        "training_seeds": TRAINING_SEEDS,
        "duration": duration,
        "skipped": SKIPPED,
        "rate": RATE,
        "cases": [
            figures_of(case, noise, [found for found, _ in done[number * runs : (number + 1) * runs]])
            for number, (case, noise) in enumerate(zip(cases, noises, strict=True))
        ],
    }


def run_and_report(runner: Path, runs: int, seed: int, names: tuple[str, ...], folder: Path) -> int:
    """Run the benchmark, write results.json to ``folder``, and print the table.

    Raises:
        DiffbotError: if the folder cannot be written, a value is not allowed or the runner fails.
    """
    with output_folder(folder):
        results = run_benchmark(runner, runs, seed, names)
        write_json(folder / "results.json", results)
        for one in CASES:
            if not names or one.name in names:
                print(described(one.name, plant=one.plant, sensors=one.sensors, filter=one.filter))
        print(table(results))
    print(f"Results in {folder}")
    return 0
