"""A moving picture of laws that drive from the same start with the same noise: ``diffbot benchmark animate``.

Not the run that looks best is shown but the most typical one, by the settling times of all laws.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from diffbot_core.errors import InvalidValueError
from diffbot_core.files import output_folder
from diffbot_lab.arena.cases import XY_TOLERANCE, YAW_TOLERANCE, cases_named, world_of
from diffbot_lab.arena.entries import OWN_NAME, entries_for
from diffbot_lab.arena.runs import run_paths
from diffbot_lab.arena.tuning import TRAINING_SEED, read_tuning, tuned_values
from diffbot_lab.paper.scenarios import starts_of
from diffbot_tools.metrics import settling_time

Array = NDArray[np.float64]

CASE = "mix"
"""realistic actuators"""
LAWS = (OWN_NAME, "rotate_drive_rotate_slow", "graceful_pose")
LABELS = {"rotate_drive_rotate_slow": "rotate, drive, rotate, slow finish"}
"""Instead of those that refer to another row of the table."""
FILE = "run.gif"


class Drive(NamedTuple):
    """What the picture shows of one law."""

    label: str
    poses: Array
    """(n, 3) [m, m, rad], true, at each sampling time"""
    settled: float
    """[s] from the start until it is within the tolerance for good; nan if it does not settle"""


class AnimationOptions(NamedTuple):
    """What is run."""

    runs: int
    """of each law, of which the most typical one is shown"""
    seed: int
    laws: tuple[str, ...] = ()
    """beside this project's; none: LAWS"""
    tuning: Path | None = None
    """a tuning.json; None: the one installed"""


def typical_run(settled: Array) -> int:
    """Return the run whose settling times are nearest to the medians of all laws, in the sum of the distances.

    Args:
        settled: (laws, runs) [s], nan for a run that does not settle; the median is of those that do.
    """
    known = np.where(np.isnan(settled), np.inf, settled)
    medians = [np.median(row[np.isfinite(row)]) if np.isfinite(row).any() else 0.0 for row in known]
    return int(np.argmin(np.abs(known - np.array(medians)[:, np.newaxis]).sum(axis=0)))


def drives(options: AnimationOptions) -> tuple[list[Drive], float]:
    """Return the same run, the most typical one, from the paper's start A under each law, and the sampling time [s].

    Raises:
        InvalidValueError: for an unknown law, or the seed of the training.
    """
    if options.seed == TRAINING_SEED:
        raise InvalidValueError("seed", options.seed, "another one than that of the tuning")
    (case,) = cases_named((CASE,))
    entries, start = entries_for(options.laws or LAWS), starts_of("a").poses[0]
    tuning = read_tuning(options.tuning)
    t_s = world_of(case)[0].sampling_time
    histories = [
        run_paths(entry, case, tuned_values(tuning, entry), start, options.runs, options.seed)[:, :, :3]
        for entry in entries
    ]
    settled = np.array([[_settled(run, t_s) for run in one] for one in histories])
    shown = typical_run(settled)
    return [
        Drive(LABELS.get(entry.name, entry.label), poses[shown], float(times[shown]))
        for entry, poses, times in zip(entries, histories, settled, strict=True)
    ], t_s


def _settled(poses: Array, t_s: float) -> float:
    inside = (np.hypot(poses[:, 0], poses[:, 1]) <= XY_TOLERANCE) & (np.abs(poses[:, 2]) <= YAW_TOLERANCE)
    time: Array = np.arange(len(poses)) * np.float64(t_s)
    return settling_time(time, inside)


def run_and_report(options: AnimationOptions, folder: Path) -> int:
    """Write the moving picture to ``folder``.

    Raises:
        DiffbotError: if the folder cannot be written or a value is not allowed.
    """
    # Loads matplotlib.
    from diffbot_lab.arena.movie.movie import write_movie  # noqa: PLC0415

    with output_folder(folder):
        shown, t_s = drives(options)
        write_movie(shown, t_s, folder / FILE)
    for one in shown:
        print(f"{one.label:<45}settled after {one.settled:.1f} s")
    print(f"Moving picture in {folder / FILE}")
    return 0
