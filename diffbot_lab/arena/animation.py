"""A moving picture of laws that drive from the same start with the same noise: ``diffbot benchmark animate``.

Whole paths are on the left, the last half metre on the right.

Not the run that looks best is shown but the most typical one, by the settling times of all laws.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.animation import PillowWriter
from matplotlib.patches import Circle
from numpy.typing import NDArray
from tqdm import tqdm

from diffbot_core.errors import InvalidValueError
from diffbot_core.files import output_folder, replacing
from diffbot_lab.arena.cases import XY_TOLERANCE, YAW_TOLERANCE, cases_named, world_of
from diffbot_lab.arena.entries import OWN_NAME, entries_for
from diffbot_lab.arena.report.figure import style_of
from diffbot_lab.arena.runs import run_paths
from diffbot_lab.arena.tuning import TRAINING_SEED, read_tuning, tuned_values
from diffbot_lab.paper.scenarios import starts_of
from diffbot_tools.metrics import settling_time
from diffbot_tools.plotting import close, new_animation

Array = NDArray[np.float64]

CASE = "mix"
"""realistic actuators"""
LAWS = (OWN_NAME, "rotate_drive_rotate_slow", "graceful_pose")
LABELS = {"rotate_drive_rotate_slow": "rotate, drive, rotate, slow finish"}
"""Instead of those that refer to another row of the table."""
FILE = "run.gif"
MAX_DURATION = 18.0
"""[s] of the picture, real time"""
_HOLD = 1.5
"""[s] after the last robot has settled"""
_DOTS = 92
"""[1/inch]: 736 pixels wide, less than 2 MB"""
_WIDE, _NEAR = 0.36, 0.075
"""[m] length of a robot's triangle in each panel"""
_HALF = 0.5
"""[m] half width of the panel near the goal"""
_TRIANGLE = np.array([(0.6, 0.0), (-0.4, 0.38), (-0.4, -0.38)])


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


class _Marks(NamedTuple):
    """What moves of one robot in one panel."""

    trail: Any
    body: Any
    length: float


def frames_of(shown: list[Drive], t_s: float) -> int:
    """Return the number of frames: one for each sampling time until all have settled and a moment longer."""
    settled = [one.settled if math.isfinite(one.settled) else math.inf for one in shown]
    duration = min(max(settled) + _HOLD, MAX_DURATION)
    return min(round(duration / t_s) + 1, *(len(one.poses) for one in shown))


def corners(pose: Array, length: float) -> Array:
    """Return the corners (3, 2) [m] of a triangle of ``length`` [m] that points along the heading of ``pose`` (3,)."""
    x, y, theta = pose
    turn = np.array([(math.cos(theta), math.sin(theta)), (-math.sin(theta), math.cos(theta))])
    return np.asarray(length * _TRIANGLE @ turn + (x, y))


def write_movie(shown: list[Drive], t_s: float, path: Path) -> None:
    """Write an endless GIF in real time, one frame for each sampling time ``t_s`` [s], with a progress bar.

    Raises:
        OSError: if the file cannot be written.
    """
    figure, wide, near = new_animation((8.0, 4.5), _DOTS)
    _draw_scene(wide, shown, _WIDE)
    _draw_scene(near, shown, _NEAR)
    _frame(wide, near, shown)
    marks = [
        [_marks(axes, index, length) for index in range(len(shown))] for axes, length in ((wide, _WIDE), (near, _NEAR))
    ]
    clock, texts = _captions(figure, wide, shown)
    with replacing(path.absolute()) as part:
        file = part.with_suffix(".gif")  # the writer takes the format from it
        writer = PillowWriter(fps=round(1.0 / t_s))
        writer.setup(figure, str(file), _DOTS)
        try:
            for frame in tqdm(range(frames_of(shown, t_s)), desc="frames", unit="frame", disable=None):
                _show(marks, shown, frame)
                clock.set_text(f"{frame * t_s:.1f} s")
                for text, one in zip(texts, shown, strict=True):
                    text.set_text(f"settled at {one.settled:.1f} s" if frame * t_s >= one.settled else "")
                writer.grab_frame()
            writer.finish()
            file.replace(part)
        finally:
            file.unlink(missing_ok=True)
            close(figure)


def _draw_scene(axes: Any, shown: list[Drive], length: float) -> None:
    axes.add_patch(Circle((0.0, 0.0), XY_TOLERANCE, facecolor="#dddddd", edgecolor="black", linewidth=0.8, zorder=1))
    outline = np.vstack([corners(np.zeros(3), length), corners(np.zeros(3), length)[:1]])
    axes.plot(*outline.T, color="black", linewidth=0.8, linestyle=":", zorder=2)
    start = corners(shown[0].poses[0], length)
    axes.plot(*np.vstack([start, start[:1]]).T, color="black", linewidth=0.8, linestyle=":", zorder=2)
    axes.set_aspect("equal")
    axes.tick_params(labelsize=8)


def _frame(wide: Any, near: Any, shown: list[Drive]) -> None:
    low = np.min([one.poses[:, :2].min(axis=0) for one in shown], axis=0) - 0.5
    high = np.max([one.poses[:, :2].max(axis=0) for one in shown], axis=0) + 0.5
    wide.set_xlim(low[0], high[0])
    wide.set_ylim(low[1], high[1])
    wide.set_xlabel("x [m]", fontsize=8)
    wide.set_ylabel("y [m]", fontsize=8)
    near.set_xlim(-_HALF, _HALF)
    near.set_ylim(-_HALF, _HALF)
    near.text(-0.95 * _HALF, 0.9 * _HALF, f"the last half metre; circle: tolerance {XY_TOLERANCE:g} m", fontsize=8)


def _marks(axes: Any, index: int, length: float) -> _Marks:
    colour, _, width = style_of(index)
    above = 20 + index
    (trail,) = axes.plot([], [], color=colour, linewidth=width, zorder=above)
    (body,) = axes.fill([0.0], [0.0], facecolor=colour, edgecolor="white", linewidth=0.6, zorder=above + 20)
    return _Marks(trail, body, length)


def _captions(figure: Any, wide: Any, shown: list[Drive]) -> tuple[Any, list[Any]]:
    """Return the texts of the running time and of each robot's settling time; there is room for seven robots."""
    clock = wide.text(0.5, 0.93, "", transform=wide.transAxes, fontsize=14, ha="right", family="monospace")
    texts = []
    row = min(0.055, 0.165 / len(shown))
    for index, one in enumerate(shown):
        height, colour = 0.945 - row * index, style_of(index)[0]
        size = 10 if len(shown) <= 3 else 7
        figure.text(0.46, height, f"\u25b6  {one.label}", fontsize=size, color=colour, weight="bold", va="center")
        texts.append(figure.text(0.985, height, "", fontsize=size, color=colour, ha="right", va="center"))
    return clock, texts


def _show(marks: list[list[_Marks]], shown: list[Drive], frame: int) -> None:
    for panel in marks:
        for mark, one in zip(panel, shown, strict=True):
            mark.trail.set_data(*one.poses[: frame + 1, :2].T)
            mark.body.set_xy(corners(one.poses[frame], mark.length))


def run_and_report(options: AnimationOptions, folder: Path) -> int:
    """Write the moving picture to ``folder``.

    Raises:
        DiffbotError: if the folder cannot be written or a value is not allowed.
    """
    with output_folder(folder):
        shown, t_s = drives(options)
        write_movie(shown, t_s, folder / FILE)
    for one in shown:
        print(f"{one.label:<45}settled after {one.settled:.1f} s")
    print(f"Moving picture in {folder / FILE}")
    return 0
