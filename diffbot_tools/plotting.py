"""Layout, colours and saving of figures. Without MPLBACKEND, matplotlib uses the backend Agg, which needs no screen."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Any

os.environ.setdefault("MPLBACKEND", "Agg")

import matplotlib.pyplot as plt

from diffbot_core.files import replacing
from diffbot_core.geometry import Pose

BLUE, ORANGE, GREY, GREEN, RED = "#0072B2", "#E69F00", "#999999", "#009E73", "#D55E00"
"""Colours that people with any colour vision can tell apart (Okabe and Ito)."""


def new_figure(rows: int, size: tuple[float, float], *, sharex: bool = True) -> tuple[Any, Any]:
    """Return a figure of ``size`` [inch] with one axes if ``rows`` is 1, or a column of axes."""
    figure, axes = plt.subplots(rows, sharex=sharex, figsize=size, dpi=110, layout="constrained")
    for one in [axes] if rows == 1 else axes:
        one.grid(alpha=0.3)
    return figure, axes


def new_grid(
    columns: int, below: int, size: tuple[float, float], left: float = 0.04
) -> tuple[Any, list[Any], list[Any]]:
    """Return a figure of ``size`` [inch], a row of ``columns`` small axes, and below it a row of ``below`` large axes.

    ``left`` is the share of the width for the labels of the y axes.
    """
    figure = plt.figure(figsize=size, dpi=100)
    upper = figure.add_gridspec(1, columns, left=left, right=0.99, bottom=0.56, top=0.94, wspace=0.08)
    lower = figure.add_gridspec(1, below, left=left, right=0.99, bottom=0.15, top=0.48, wspace=0.1)
    small = [figure.add_subplot(upper[0, index]) for index in range(columns)]
    large = [figure.add_subplot(lower[0, index]) for index in range(below)]
    for one in (*small, *large):
        one.grid(alpha=0.3)
    return figure, small, large


def draw_heading(axes: Any, pose: Pose, length: float, colour: str) -> None:
    """Draw an arrow of ``length`` [m] from a pose in the direction of its heading."""
    tip = pose.x + length * math.cos(pose.theta), pose.y + length * math.sin(pose.theta)
    axes.annotate(
        "", tip, (pose.x, pose.y), arrowprops={"arrowstyle": "-|>", "color": colour, "linewidth": 2.0}, zorder=5
    )
    # An arrow whose tip is outside the limits of the axes would not be drawn.
    axes.update_datalim([tip])
    axes.autoscale_view()


def save(figure: Any, *paths: Path) -> None:
    """Save a figure in the format of each path's suffix, replacing each file as a whole, and close the figure."""
    for path in paths:
        with replacing(path) as part:
            figure.savefig(part, format=path.suffix[1:])
    plt.close(figure)
