"""Draw figures 4 to 15 of the paper from our runs.

Each figure has a thin line for each run and a thick line for one run of each start. The range from the 5 % to the 95 %
quantile is shaded.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.collections import LineCollection
from numpy.typing import NDArray
from tqdm import tqdm

from diffbot_lab.paper.experiment import Group
from diffbot_tools.plotting import new_figure, save

Array = NDArray[np.float64]

_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000", "#999933")
FIRST_FIGURE = {"law 13": 4, "law 17": 7, "heading 0 deg": 10, "heading 220 deg": 13}
"""Number of each group's figure of the path in the paper. The figures of pose and command have the next two numbers."""


class FigureData(NamedTuple):
    """Content of one figure."""

    title: str
    time: Array
    """(steps + 1,) [s]"""
    histories: Array
    """(runs, steps + 1, 12)"""
    starts: int
    """number of starts; run i has the start i modulo this number"""


def draw_figures(groups: list[Group], folder: Path) -> None:
    """Draw the three figures of each group into the folder of its setting. On a terminal, show a progress bar.

    Raises:
        OSError: if a file cannot be written.
    """
    for group in tqdm(groups, desc="figures", unit="group", disable=None):
        target = folder / group.setting.name
        target.mkdir(exist_ok=True)
        time = np.arange(group.histories.shape[1]) * np.float64(group.setting.plant.sampling_time)
        label = group.law if group.label == group.law else f"{group.law}, {group.label}"
        data = FigureData(f"{label}, {group.setting.name}", time, group.histories, len(group.starts.poses))
        draws = ((_draw_path, "path"), (_draw_pose, "pose"), (_draw_command, "command"))
        for number, (draw, what) in enumerate(draws, FIRST_FIGURE[group.label]):
            save(draw(data), target / f"figure_{number:02d}_{what}.png")


def _draw_path(data: FigureData) -> Any:
    figure, axes = new_figure(1, (6.4, 5.6))
    poses = data.histories[:, :, :2]
    for start in range(data.starts):
        _faint(axes, [poses[run] for run in range(start, len(poses), data.starts)], _COLOURS[start])
    for start in range(data.starts):
        axes.plot(*poses[start].T, color=_COLOURS[start], linewidth=1.6, label="one run" if start == 0 else None)
        x, y, theta = data.histories[start, 0, :3]
        span = float(np.ptp(poses[:, 0, 0])) or float(np.hypot(x, y))
        dx, dy = 0.06 * span * math.cos(theta), 0.06 * span * math.sin(theta)
        axes.arrow(x, y, dx, dy, width=0.008 * span, color="black")
    axes.plot(0.0, 0.0, "x", color="black", markersize=9, label="goal (heading 0)")
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    axes.set_title(f"Path: {data.title}")
    axes.legend(fontsize="small")
    return figure


def _draw_pose(data: FigureData) -> Any:
    columns = [data.histories[:, :, 0], data.histories[:, :, 1], np.unwrap(data.histories[:, :, 2], axis=1)]
    return _draw_series(data, columns, ("x [m]", "y [m]", "theta [rad]"), f"Pose: {data.title}")


def _draw_command(data: FigureData) -> Any:
    # The last row is the end pose, without a command.
    cut = FigureData(data.title, data.time[:-1], data.histories[:, :-1], data.starts)
    columns = [cut.histories[:, :, 6], cut.histories[:, :, 7]]
    return _draw_series(cut, columns, ("v [m/s]", "omega [rad/s]"), f"Command: {data.title}")


def _draw_series(data: FigureData, columns: list[Array], labels: tuple[str, ...], title: str) -> Any:
    figure, all_axes = new_figure(len(columns), (6.4, 1.9 * len(columns) + 0.6))
    for axes, values, label in zip(all_axes, columns, labels, strict=True):
        for start in range(data.starts):
            runs = values[start :: data.starts]
            _faint(axes, [np.column_stack([data.time, run]) for run in runs], _COLOURS[start])
            low, high = np.quantile(runs, (0.05, 0.95), axis=0)
            axes.fill_between(data.time, low, high, color=_COLOURS[start], alpha=0.2, linewidth=0)
        for start in range(data.starts):
            axes.plot(data.time, values[start], color=_COLOURS[start], linewidth=1.3)
        axes.set_ylabel(label)
        axes.autoscale_view()
    all_axes[0].set_title(title)
    all_axes[-1].set_xlabel("time [s]")
    return figure


def _faint(axes: Any, lines: list[Array], colour: str) -> None:
    axes.add_collection(LineCollection(lines, colors=colour, linewidths=0.5, alpha=0.15))
