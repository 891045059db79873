"""The picture of simulated drives."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from diffbot_sim.drive import Drive
from diffbot_tools.plotting import BLUE, GREEN, RED


def draw_drives(figure: Any, drives: Sequence[Drive]) -> None:
    """Draw true and estimated paths with their goals, and the true distance from each goal over time."""
    path_axes, error_axes = figure.subplots(1, 2)
    span = max(np.ptp(np.vstack([one.truth[:, :2] for one in drives]), axis=0).max(), 0.3)
    for number, drive in enumerate(drives):
        shown = number == 0
        path_axes.plot(*drive.truth[:, :2].T, color=BLUE, linewidth=2.0, label="truth" if shown else None)
        path_axes.plot(*drive.estimate[:, :2].T, color=RED, linewidth=0.7, label="estimate" if shown else None)
        x, y, theta = drive.goal
        path_axes.plot([x], [y], "o", color=GREEN if drive.is_reached else RED, label="goal" if shown else None)
        tip = x + 0.05 * span * np.cos(theta), y + 0.05 * span * np.sin(theta)
        path_axes.annotate("", tip, (x, y), arrowprops={"arrowstyle": "->", "color": GREEN})
        distance = np.hypot(drive.truth[:, 0] - x, drive.truth[:, 1] - y)
        error_axes.plot(drive.time - drive.time[0], distance, color=BLUE, linewidth=1.0, alpha=0.7)
    path_axes.set(xlabel="x [m]", ylabel="y [m]")
    path_axes.set_aspect("equal", adjustable="datalim")
    path_axes.legend(fontsize="small")
    error_axes.set(xlabel="time since the goal was sent [s]", ylabel="true distance from the goal [m]")
    error_axes.set_yscale("log")
    for axes in (path_axes, error_axes):
        axes.grid(alpha=0.3)
