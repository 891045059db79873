"""``diffbot benchmark calibration``: are the errors of simulated robots inside the intervals that it states?"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from tqdm import tqdm

from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_core.files import output_folder, write_json, write_text
from diffbot_lab.campaign.statistics import wilson
from diffbot_lab.targets import markdown_table
from diffbot_tools.calibration.calibrate import calibrate
from diffbot_tools.calibration.likelihood import run_events
from diffbot_tools.calibration.quantities import with_values
from diffbot_tools.calibration.settings import NIS, NUMBERS
from diffbot_tools.calibration.simulation import Errors, events_of, record

SECONDS = 300.0
"""[s] of each drive"""
RADIUS, SEPARATION, DELAY, NOISE = 0.03, 0.05, 0.2, 3.0
"""True errors: of the radii and the separation, with either sign; [s]; factor on all deviations."""
_INSIDE = 1.96
"""standard deviations on either side of a 95 % interval"""
NAMES = (
    "odometry_delay", "odometry_covariance_scale", "xy_factor", "yaw_factor", "left_radius_error",
    "right_radius_error", "wheel_separation_error",
)  # fmt: skip


class Found(NamedTuple):
    """One drive."""

    z: list[float]
    """error of each number of NAMES over the standard deviation that the calibration states"""
    sigma: list[float]
    """those standard deviations"""
    nis_before: float
    """mean NIS per number with the given parameters, over the held-out minutes"""
    nis_held_out: float
    """with the parameters of the other minutes"""
    nis_after: float
    """with the parameters found from the whole drive, over all of it"""
    bound: float
    """95 % of such means over the whole drive are within 1 +- this"""


def evaluate(seed: int) -> Found:
    """Calibrate on one simulated drive; ``seed`` decides on its noise, its way and the signs of its errors."""
    signs = np.random.default_rng([seed, 1]).choice((-1.0, 1.0), 3)
    left, right, separation = (signs * (RADIUS, RADIUS, SEPARATION)).tolist()
    events = events_of(record(Errors(left, right, separation, DELAY, NOISE), seed, SECONDS))
    found = calibrate([events], EkfNodeConfig(), lambda: None)
    truth = {
        "odometry_delay": DELAY,
        "odometry_covariance_scale": math.log(NOISE**2),
        "xy_factor": math.log(NOISE),
        "yaw_factor": math.log(NOISE),
    }
    deviations = np.sqrt(np.diag(found.found.covariance)).tolist()
    estimated = {
        one.name: (value, sigma)
        for one, value, sigma in zip(found.quantities, found.found.values.tolist(), deviations, strict=True)
    }
    values = [*(estimated[name][0] - truth[name] for name in truth), *(found.constants[:3] - (left, right, separation))]
    sigmas = [*(estimated[name][1] for name in truth), *np.sqrt(np.diag(found.constants_covariance))[:3]]
    settings = with_values(found.settings, found.quantities, found.found.values)
    result = run_events(events, found.prior, settings).result
    numbers = float(result[:, NUMBERS].sum())
    return Found(
        [float(value / sigma) if sigma > 0.0 else math.inf for value, sigma in zip(values, sigmas, strict=True)],
        [float(one) for one in sigmas],
        found.before.consistency.nis,
        found.after.consistency.nis,
        float(result[:, NIS].sum()) / numbers,
        _INSIDE * math.sqrt(2.0 / numbers),
    )


def results_of(found: list[Found], seed: int) -> dict[str, Any]:
    """Return the content of results.json."""
    z = np.array([one.z for one in found])
    inside = (np.abs(z) <= _INSIDE).sum(axis=0)
    nis = sum(abs(one.nis_after - 1.0) <= one.bound for one in found)
    return {
        "runs": len(found),
        "seed": seed,
        "seconds": SECONDS,
        "numbers": [
            {
                "name": name,
                "inside": int(inside[index]),
                "interval": list(wilson(int(inside[index]), len(found))),
                "sigma": float(np.median([one.sigma[index] for one in found])),
                "rms": float(np.sqrt(np.mean(z[:, index] ** 2))),
            }
            for index, name in enumerate(NAMES)
        ],
        "nis_before": float(np.mean([one.nis_before for one in found])),
        "nis_held_out": [min(one.nis_held_out for one in found), max(one.nis_held_out for one in found)],
        "nis_after": [min(one.nis_after for one in found), max(one.nis_after for one in found)],
        "nis_bound": float(np.mean([one.bound for one in found])),
        "nis_inside": int(nis),
    }


def table(results: dict[str, Any]) -> str:
    """Return the figures in Markdown."""
    runs = results["runs"]
    rows = [
        (
            one["name"],
            f"{one['sigma']:.2g}",
            f"{one['inside']} of {runs}",
            f"{100.0 * one['interval'][0]:.0f} .. {100.0 * one['interval'][1]:.0f} %",
            f"{one['rms']:.2f}",
        )
        for one in results["numbers"]
    ]
    head = (
        "number",
        "its deviation, median",
        "inside its 95 % interval",
        "of all drives (95 %)",
        "rms error / deviation",
    )
    low, high = results["nis_after"]
    first, last = results["nis_held_out"]
    note = (
        f"Mean NIS per number: {results['nis_before']:.1f} before; with the numbers found, over the same drive, "
        f"{low:.3f} .. {high:.3f}, in {results['nis_inside']} of {runs} drives inside the 95 % bounds "
        f"1 +- {results['nis_bound']:.3f}; over minutes that were not used, {first:.3f} .. {last:.3f}."
    )
    return "\n".join([*markdown_table(head, rows), "", note])


def run_and_report(runs: int, seed: int, out: Path) -> int:
    """Calibrate on ``runs`` simulated drives with the seeds from ``seed`` on; write results.json and table.md.

    Raises:
        DiffbotError: if ``out`` cannot be written, or numba is not installed.
    """
    with output_folder(out):
        bar = tqdm(range(seed, seed + runs), desc="calibrate", unit="drive", disable=None)
        results = results_of([evaluate(one) for one in bar], seed)
        write_json(out / "results.json", results)
        write_text(out / "table.md", table(results) + "\n")
    print(table(results))
    print(f"Results in {out}")
    return 0
