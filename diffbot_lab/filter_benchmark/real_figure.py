"""The figure of one real drive: its path, and the errors of the filter with its own three standard deviations."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np

from diffbot_tools.plotting import BLUE, GREY, ORANGE, save
from diffbot_tools.refilter.comparison import Errors

_MAX_POINTS = 4000
"""Points of a curve; more are not visible."""


def draw_drive(name: str, errors: Errors, path: Path) -> None:
    """Draw path, errors of position and heading, and NEES over time.

    Args:
        name: title.
        errors: of the drive.
        path: of the PNG.

    Raises:
        OSError: if the file cannot be written.
    """
    step = max(1, len(errors.time) // _MAX_POINTS)
    time, truth, error, P = (values[::step] for values in errors)
    figure = plt.figure(figsize=(13.0, 6.0), dpi=100, layout="constrained")
    grid = figure.add_gridspec(3, 2, width_ratios=(1.0, 1.6))
    _draw_path(figure.add_subplot(grid[:, 0]), name, truth, truth + error)
    variances = np.linalg.eigvalsh(P[:, :2, :2])[:, 1]
    below = [figure.add_subplot(grid[row, 1]) for row in range(3)]
    _draw_error(below[0], time, np.hypot(error[:, 0], error[:, 1]), variances, "position [m]")
    _draw_error(below[1], time, np.abs(error[:, 2]), P[:, 2, 2], "heading [rad]")
    numbers = 3 if np.isfinite(error).all() else 2
    e, P = error[:, :numbers], P[:, :numbers, :numbers]
    below[2].semilogy(time, np.einsum("ni,ni->n", e, np.linalg.solve(P, e[:, :, None])[:, :, 0]), color=BLUE, lw=0.7)
    below[2].axhline(numbers, color="black", lw=0.8, label=f"expected: {numbers}")
    below[2].set_ylim(1e-2, None)
    below[2].set_ylabel("NEES")
    below[2].set_xlabel("time [s]")
    for axes in below:
        axes.set_xlim(time[0], time[-1])
        axes.grid(alpha=0.3)
        axes.legend(loc="upper right", fontsize="x-small")
    save(figure, path)


def _draw_path(axes: Any, name: str, truth: Any, estimate: Any) -> None:
    axes.plot(truth[:, 0], truth[:, 1], color=GREY, lw=1.2, label="reference")
    axes.plot(estimate[:, 0], estimate[:, 1], color=BLUE, lw=0.7, label="estimate")
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_title(name, fontsize="medium")
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    axes.grid(alpha=0.3)
    axes.legend(loc="upper right", fontsize="x-small")


def _draw_error(axes: Any, time: Any, error: Any, variance: Any, label: str) -> None:
    axes.fill_between(time, 0.0, 3.0 * np.sqrt(variance), color=ORANGE, alpha=0.3, label="3 sigma of the filter")
    axes.plot(time, error, color="black", lw=0.7, label="error")
    if np.isfinite(error).any():
        axes.set_ylim(0.0, 1.3 * np.nanmax(error) + 1e-9)
    axes.set_ylabel(label)
