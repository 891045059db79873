"""The filter's variants on the same drives: ``diffbot benchmark localization``.

The drives are open-loop, since feedback would hide the filter's errors. Run i of each case and variant drives the same
arc with the noise of (seed, i).
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri
from tqdm import tqdm

from diffbot_control.filter.options import FILTERS, FilterConfig
from diffbot_core.errors import InvalidValueError
from diffbot_core.files import output_folder, write_json
from diffbot_lab.cases import described
from diffbot_lab.filter_benchmark.cases import DURATION, SCENARIOS, SKIPPED, Scenario, drive_of, name_of
from diffbot_lab.filter_benchmark.report import table
from diffbot_sim.compiled.batch import in_threads
from diffbot_sim.compiled.jit import compile_kernel
from diffbot_sim.compiled.open_loop import AWAY, OpenLoopCase, Tracking, drive

Array = NDArray[np.float64]

COLUMNS = Tracking._fields
HISTORY_COLUMNS = ("position", "heading", "sigma_xy", "sigma_theta")
SIZE = 3
"""Dimension of a pose and of a fix."""
FAULTY = next(one for one in SCENARIOS if one.name == "all")
RATES_OF_FIGURE = (10, 5)
RUN_OF_FIGURE = 0
_CHUNK = 16
"""Runs per call of a thread."""


def _fill(case: OpenLoopCase, seed: int, first: int, trackings: Any, histories: Any) -> None:
    for index in range(len(trackings)):
        row, tracking = trackings[index], drive(case, seed, first + index, histories[index])
        row[0], row[1], row[2], row[3] = tracking.position, tracking.heading, tracking.largest, tracking.end
        row[4], row[5], row[6], row[7] = tracking.back, tracking.nis, tracking.innovations, tracking.nees
        row[8], row[9], row[10] = tracking.fixes, tracking.rejected, tracking.relocated


_kernel = compile_kernel(_fill)


def run_drives(case: OpenLoopCase, seed: int, runs: int, threads: int | None = None) -> Array:
    """Simulate the runs 0 to ``runs - 1`` on ``threads`` threads; None for one per core.

    Returns:
        (runs, 11), a row per run, columns as COLUMNS; the same for any number of threads.
    """
    trackings: Array = np.empty((runs, len(COLUMNS)))
    histories: Array = np.empty((runs, 0, len(HISTORY_COLUMNS)))  # not recorded
    parts = []
    for at in range(0, runs, _CHUNK):
        rows = slice(at, at + _CHUNK)
        parts.append((case, seed, at, trackings[rows], histories[rows]))
    in_threads(_kernel, parts, threads)
    return trackings


def run_history(case: OpenLoopCase, seed: int, run: int) -> Array:
    """Simulate one run and return its history (steps + 1, 4), columns as HISTORY_COLUMNS [m, rad, m, rad]."""
    histories: Array = np.empty((1, case.steps + 1, len(HISTORY_COLUMNS)))
    _kernel(case, seed, run, np.empty((1, len(COLUMNS))), histories)
    history: Array = histories[0]
    return history


def figures_of(trackings: Array) -> dict[str, Any]:
    """Turn the rows of many runs, columns as COLUMNS, into the figures of one case and filter."""
    column = {name: trackings[:, index] for index, name in enumerate(COLUMNS)}
    runs = len(trackings)
    innovations = column["innovations"]
    counted = float(innovations.sum())
    # Whole steps: 28 of 0.1 s are 2.8 s, without the rounding error of the product.
    back = np.round(column["back"][~np.isnan(column["back"])], 9)
    return {
        "runs": runs,
        "position": _pooled(column["position"]),
        "heading": _pooled(column["heading"]),
        "largest": float(column["largest"].max()),
        "lost": int((~(column["end"] <= AWAY)).sum()),
        "back_median": float(np.median(back)) if len(back) else None,
        "back_max": float(back.max()) if len(back) else None,
        "nis": float((column["nis"] * innovations).sum() / counted) if counted else None,
        "nis_low": _bound(0.025, counted),
        "nis_high": _bound(0.975, counted),
        "nis_inside": _share_inside(column["nis"], innovations) if counted else None,
        "nees": float(column["nees"].mean()),
        "nees_low": _bound(0.025, runs),
        "nees_high": _bound(0.975, runs),
        "rejected": float(column["rejected"].sum() / column["fixes"].sum()),
        "relocations": float(column["relocated"].mean()),
    }


def _pooled(errors: Array) -> dict[str, float]:
    """Pool the RMSE of runs of equal length: RMSE over all of them, median and 95 % of the runs."""
    return {
        "rmse": math.sqrt(float((errors**2).mean())),
        "median": float(np.median(errors)),
        "p95": float(np.quantile(errors, 0.95)),
    }


def _bound(share: float, samples: float) -> float | None:
    """Quantile of the mean of ``samples`` chi-square variables with SIZE degrees of freedom; None for no samples."""
    dof = SIZE * samples
    return float(chdtri(dof, 1.0 - share) / samples) if samples else None


def _share_inside(nis: Array, innovations: Array) -> float:
    low, high = (chdtri(SIZE * innovations, 1.0 - share) / innovations for share in (0.025, 0.975))
    return float(((low <= nis) & (nis <= high)).mean())


def run_benchmark(runs: int, seed: int) -> dict[str, Any]:
    """Execute all runs of all cases, with a progress bar on a terminal; return the content of results.json.

    Raises:
        InvalidValueError: for fewer than one run.
    """
    if runs < 1:
        raise InvalidValueError("runs", runs, ">= 1")
    cases = []
    total = sum(len(one.rates) for one in SCENARIOS) * len(FILTERS)
    with tqdm(total=total, desc="benchmark", unit="case", disable=None) as bar:
        for scenario in SCENARIOS:
            for odometry_rate, fix_rate in scenario.rates:
                filters = {}
                for name in FILTERS:
                    case = drive_of(scenario, odometry_rate, fix_rate, name)
                    filters[name] = figures_of(run_drives(case, seed, runs))
                    bar.update()
                cases.append(_described(scenario, odometry_rate, fix_rate) | {"filters": filters})
    return {
        "runs": runs,
        "seed": seed,
        "duration": DURATION,
        "skipped": SKIPPED,
        "default_filter": FilterConfig().filter,
        "cases": cases,
    }


def _described(scenario: Scenario, odometry_rate: int, fix_rate: int) -> dict[str, Any]:
    return {
        "name": name_of(scenario.name, odometry_rate, fix_rate),
        "scenario": scenario.name,
        "section": scenario.section,
        "text": scenario.text,
        "odometry_rate": odometry_rate,
        "fix_rate": fix_rate,
    }


def run_and_report(runs: int, seed: int, folder: Path, figures: bool) -> int:
    """Run the benchmark, write results.json and localization.png to ``folder``, and print the tables.

    Raises:
        DiffbotError: if the folder cannot be written or a value is not allowed.
    """
    with output_folder(folder):
        results = run_benchmark(runs, seed)
        write_json(folder / "results.json", results)
        print(*(described(one.name, plant=one.plant, sensors=one.sensors) for one in SCENARIOS), sep="\n")
        print("filter: as in the column, otherwise not the default: nothing; rates: as in the row")
        print(table(results))
        if figures:
            draw(results, folder / "localization.png")
    print(f"Results in {folder}")
    return 0


def draw(results: dict[str, Any], path: Path) -> None:
    """Draw one faulty run of each variant, and the errors of all cases."""
    # Loads matplotlib.
    from diffbot_lab.filter_benchmark.figure import draw_localization  # noqa: PLC0415

    odometry_rate, fix_rate = RATES_OF_FIGURE
    histories = {
        name: run_history(drive_of(FAULTY, odometry_rate, fix_rate, name), results["seed"], RUN_OF_FIGURE)
        for name in FILTERS
    }
    draw_localization(results, histories, 1.0 / odometry_rate, path)
