"""Readings of the paper's simulation A over the radius of Omega_L: ``diffbot experiment scan``.

The paper states neither eps_P nor how its measurement noise depends on the pose. For each reading of the noise and each
radius, the scan counts the runs that end like the paper's single runs.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from diffbot_core.errors import InvalidValueError
from diffbot_core.files import output_folder, write_json
from diffbot_lab.campaign.statistics import wilson
from diffbot_lab.paper.experiment import heading
from diffbot_lab.paper.scenarios import PAPER_END_STATES, SETTINGS, Setting, case_of, starts_of
from diffbot_sim.compiled.batch import HISTORY_COLUMNS, run_histories

Array = NDArray[np.float64]

RADII = (0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.45, 0.5)
"""[m] values of eps_P"""
LAST = 10.0
"""[s] at the end of a run over which the standard deviation of v is taken"""
BOX = (0.02, 0.02, 0.02)
"""[m], [m], [rad] half widths of the box about the magnitudes of the paper's end state under law (17)"""
_RUNS_AT_A_TIME = 2000
_BY_NAME = {setting.name: setting for setting in SETTINGS}
_HEADING_ONLY = _BY_NAME["raw"]._replace(
    name="heading only",
    text="no position noise, only heading and input noise",
    sensors=_BY_NAME["raw"].sensors._replace(eps_x_max=0.0, eps_y_max=0.0),
)
READINGS: tuple[Setting, ...] = (_BY_NAME["raw"], _BY_NAME["vanishing"], _HEADING_ONLY)


class Ends(NamedTuple):
    """What the scan needs of runs."""

    poses: Array
    """(runs, 3) [m, m, rad] at the end"""
    deviations: Array
    """(runs,) [m/s] standard deviation of the commanded v over the last LAST seconds"""


def is_near_goal(poses: Array) -> NDArray[np.bool_]:
    """Return which of ``poses`` (n, 3) are as near to the goal as the paper's run under law (13)."""
    x, y, _ = PAPER_END_STATES["law 13"]
    return np.asarray(np.hypot(poses[:, 0], poses[:, 1]) <= math.hypot(x, y))


def is_in_box(poses: Array) -> NDArray[np.bool_]:
    """Return which of ``poses`` (n, 3) are, in magnitude, within BOX of the paper's end state under law (17)."""
    paper = np.abs(PAPER_END_STATES["law 17"])
    return np.asarray((np.abs(np.abs(poses) - paper) <= BOX).all(axis=1))


def run_ends(law: str, setting: Setting, runs: int, seed: int) -> Ends:
    """Execute runs of simulation A; the memory does not grow with their number."""
    case, starts = case_of(law, setting), starts_of("a")
    last = round(LAST / setting.plant.sampling_time)
    poses: Array = np.empty((runs, 3))
    deviations: Array = np.empty(runs)
    for first in range(0, runs, _RUNS_AT_A_TIME):
        part = slice(first, min(first + _RUNS_AT_A_TIME, runs))
        histories = run_histories(case, starts, seed, first, part.stop - first)
        poses[part] = histories[:, -1, :3]
        deviations[part] = histories[:, -last:, HISTORY_COLUMNS.index("v")].std(axis=1)
    return Ends(poses, deviations)


def run_scan(runs: int, seed: int) -> dict[str, Any]:
    """Execute all runs of the scan, with a progress bar on a terminal; return the content of results.json.

    Args:
        runs: of each law, reading and radius.
        seed: of all noise.

    Raises:
        InvalidValueError: for fewer than one run.
    """
    if runs < 1:
        raise InvalidValueError("runs", runs, ">= 1")
    law_13, law_17 = [], []
    with tqdm(total=len(READINGS) * (len(RADII) + 1), desc="scan", unit="cell", disable=None) as bar:
        for reading in READINGS:
            ends = run_ends("law 13", reading, runs, seed)
            law_13.append({"reading": reading.name} | _counted(ends, is_near_goal))
            bar.update()
            for radius in RADII:
                ends = run_ends("law 17", reading._replace(eps_P=radius), runs, seed)
                law_17.append({"reading": reading.name, "eps_P": radius} | _counted(ends, is_in_box))
                bar.update()
    return {
        "experiment": "scan",
        "runs": runs,
        "seed": seed,
        "box": list(BOX),
        "last": LAST,
        "readings": {reading.name: reading.text for reading in READINGS},
        "law 13": law_13,
        "law 17": law_17,
    }


def _counted(ends: Ends, agrees: Callable[[Array], NDArray[np.bool_]]) -> dict[str, Any]:
    y, found = ends.poses[:, 1], agrees(ends.poses)
    runs, count = len(found), int(found.sum())
    return {
        "agree": count / runs,
        "agree_interval": list(wilson(count, runs)),
        "agree_positive_y": float((found & (y > 0.0)).mean()),
        "median_abs_y": float(np.median(np.abs(y))),
        "positive_y": float((y > 0.0).mean()),
        "median_sd_v": float(np.median(ends.deviations)),
    }


def run_and_report(runs: int, seed: int, folder: Path) -> None:
    """Run the scan, write results.json to ``folder``, and print a table.

    Raises:
        DiffbotError: if the folder cannot be written or a value is not allowed.
    """
    with output_folder(folder):
        results = run_scan(runs, seed)
        write_json(folder / "results.json", results)
    print(f"{heading(READINGS)}\neps_P of law 17: as in the row\n{table(results)}")


def table(results: dict[str, Any]) -> str:
    """Lay out the scan for a terminal."""
    head = f"{'scan':<14}{'law':>4}{'eps_P [m]':>11}{'like the paper [%]':>20}{'95 % interval':>16}"
    head += f"{'|y| median [m]':>16}{'y > 0 [%]':>11}{'sd of v [m/s]':>15}"
    rows = [head, "-" * len(head)]
    for law in ("law 13", "law 17"):
        for one in results[law]:
            low, high = (100.0 * share for share in one["agree_interval"])
            radius = f"{one['eps_P']:.2f}" if "eps_P" in one else "-"
            rows.append(
                f"{one['reading']:<14}{law[-2:]:>4}{radius:>11}{100.0 * one['agree']:>20.2f}"
                f"{f'{low:.2f} to {high:.2f}':>16}{one['median_abs_y']:>16.3f}{100.0 * one['positive_y']:>11.1f}"
                f"{one['median_sd_v']:>15.3f}"
            )
    return "\n".join(rows)
