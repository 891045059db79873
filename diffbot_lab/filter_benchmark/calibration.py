"""``diffbot benchmark calibration``: are the errors of simulated robots inside the intervals that it states?"""

from __future__ import annotations

import math
import os
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from tqdm import tqdm

from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_core.files import output_folder, write_json, write_text
from diffbot_core.schema import build
from diffbot_lab.campaign.statistics import wilson
from diffbot_lab.cases import described
from diffbot_lab.targets import markdown_table
from diffbot_tools.calibration.calibrate import calibrate
from diffbot_tools.calibration.quantities import CONSTANTS
from diffbot_tools.calibration.simulation import SECOND, Errors, Sensors, events_of, record

SECONDS = 300.0
"""[s] of each drive"""
RADIUS, SEPARATION, DELAY = 0.03, 0.05, 0.2
"""True errors: of the radii and the separation, with either sign; [s]."""
OFFSET, SCALE, BEARING, BIAS, LASTING = 0.05, 0.02, 0.02, 0.02, 1.5
"""Likewise of ranges [m] and [-], bearings [rad] and the gyro [rad/s], with either sign; how long errors last [s]."""
TITLES = (
    "drives with", "drives", "true numbers inside their 95 % intervals (of all such drives, 95 %)", "each number",
    "NIS before", "held out",
)  # fmt: skip
_INSIDE = 1.96
"""standard deviations on either side of a 95 % interval"""


class Case(NamedTuple):
    """What the drives of a case have."""

    sensors: Sensors
    lasting: bool
    """errors of fixes and landmarks are correlated in time"""
    noise: float
    """factor on all deviations"""
    config: EkfNodeConfig

    def truth(self) -> dict[str, float]:
        """Return the numbers that the optimiser has to find, all but the delay as logarithms."""
        sensors, noise = self.sensors, math.log(self.noise)
        found = {"odometry_delay": DELAY, "odometry_covariance_scale": 2.0 * noise}
        found |= dict.fromkeys(("xy_factor", "yaw_factor"), noise) if sensors.fixes else {}
        found |= dict.fromkeys(("range_factor", "bearing_factor"), noise) if sensors.landmarks else {}
        found |= dict.fromkeys((f"{SECOND} xy_factor", f"{SECOND} yaw_factor"), noise) if sensors.second else {}
        found |= {"gyro_factor": noise} if sensors.gyro else {}
        name = "fix_correlation_time" if sensors.fixes else "landmark_correlation_time"
        return found | ({name: math.log(LASTING)} if self.lasting else {})


CASES = {
    "fixes": Case(Sensors(), False, 3.0, EkfNodeConfig()),
    "correlated fixes": Case(Sensors(), True, 3.0, EkfNodeConfig()),
    "correlated landmarks": Case(Sensors(fixes=0, landmarks=5), True, 3.0, EkfNodeConfig()),
    # The messages' covariances follow the measured wheel speeds, which 15 % of noise would make wrong: a gyro shows it.
    "second source and gyro": Case(
        Sensors(second=10, gyro=True), True, 1.0, build(EkfNodeConfig, {"pose_sources": [SECOND], "use_gyro": True})
    ),
}


class Found(NamedTuple):
    """One drive."""

    z: dict[str, float]
    """error of each number over the standard deviation that the calibration states; inf: not found"""
    sigma: dict[str, float]
    """those standard deviations"""
    nis_before: float
    """mean NIS per number with the given parameters, over the held-out minutes"""
    nis_held_out: float
    """with the parameters of the other minutes"""


def evaluate(case: Case, seed: int) -> Found:
    """Calibrate on one simulated drive; ``seed`` decides on its noise, its way and the signs of its errors."""
    signs = np.random.default_rng([seed, 1]).choice((-1.0, 1.0), 7)
    sizes = (RADIUS, RADIUS, SEPARATION, OFFSET, SCALE, BEARING, BIAS)
    left, right, separation, offset, scale, bearing, bias = (signs * sizes).tolist()
    lasting = LASTING if case.lasting else 0.0
    wheels, landmarks = Errors(left, right, separation, DELAY, case.noise, lasting), (offset, scale, bearing)
    errors = wheels._replace(range_offset=offset, range_scale=scale, bearing_offset=bearing, gyro_bias=bias)
    found = calibrate([events_of(record(errors, seed, SECONDS, case.sensors))], case.config, lambda: None)
    truth = case.truth()
    sigmas = np.sqrt(np.diag(found.found.covariance)).tolist()
    names = [one.name for one in found.quantities]
    estimated = dict(zip(names, zip(found.found.values.tolist(), sigmas, strict=True), strict=True))
    sigmas = np.sqrt(np.diag(found.constants_covariance)).tolist()
    for index, true in enumerate((left, right, separation, *(landmarks if case.sensors.landmarks else ()))):
        name = CONSTANTS[index]
        truth[name], estimated[name] = true, (float(found.constants[index]), sigmas[index])
    z, sigma = {}, {}
    for name, true in truth.items():
        value, sigma[name] = estimated.get(name, (0.0, 0.0))
        z[name] = (value - true) / sigma[name] if sigma[name] > 0.0 else math.inf
    return Found(z, sigma, found.before.consistency.nis, found.after.consistency.nis)


def results_of(found: list[Found]) -> dict[str, Any]:
    """Return the results of the drives of a case."""
    names = list(found[0].z)
    z = np.array([[one.z[name] for name in names] for one in found])
    inside = np.abs(z) <= _INSIDE
    count = int(inside.sum())
    return {
        "runs": len(found),
        "inside": count,
        "of": inside.size,
        "interval": list(wilson(count, inside.size)),
        "numbers": [
            {
                "name": name,
                "inside": int(inside[:, index].sum()),
                "sigma": float(np.median([one.sigma[name] for one in found])),
                "rms": float(np.sqrt(np.mean(z[:, index] ** 2))),
            }
            for index, name in enumerate(names)
        ],
        "nis_before": float(np.mean([one.nis_before for one in found])),
        "nis_held_out": [min(one.nis_held_out for one in found), max(one.nis_held_out for one in found)],
    }


def table(results: dict[str, Any]) -> str:
    """Return the figures of all cases in Markdown."""
    rows = []
    for case, one in results["cases"].items():
        low, high = (100.0 * share for share in one["interval"])
        share = f"{one['inside']} of {one['of']}: {100.0 * one['inside'] / one['of']:.1f} % ({low:.0f} .. {high:.0f})"
        numbers = ", ".join(f"{number['name']} {number['inside']}" for number in one["numbers"])
        first, last = one["nis_held_out"]
        rows.append((case, str(one["runs"]), share, numbers, f"{one['nis_before']:.1f}", f"{first:.2f} .. {last:.2f}"))
    return "\n".join(markdown_table(TITLES, rows))


def run_and_report(runs: int, seed: int, out: Path) -> int:
    """Calibrate on ``runs`` simulated drives of each case, of the seeds from ``seed`` on; write what was found.

    Raises:
        DiffbotError: if ``out`` cannot be written, or numba is not installed.
    """
    with output_folder(out):
        cases = {}
        # Threads: nearly all of the time goes into compiled code, which releases the interpreter's lock.
        with ThreadPoolExecutor(os.cpu_count()) as pool, ExitStack() as when_interrupted:
            when_interrupted.callback(pool.shutdown, wait=False, cancel_futures=True)
            for name, case in CASES.items():
                drives = pool.map(partial(evaluate, case), range(seed, seed + runs))
                cases[name] = results_of(list(tqdm(drives, desc=name, total=runs, unit="drive", disable=None)))
        results = {"seed": seed, "seconds": SECONDS, "cases": cases}
        write_json(out / "results.json", results)
        write_text(out / "table.md", table(results) + "\n")
    for name, case in CASES.items():
        print(described(f"{name}: deviations times {case.noise:g}", ekf=case.config))
    print(table(results))
    print(f"Results in {out}")
    return 0
