"""Figures of runs, drawn with matplotlib without a screen."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np

from diffbot_core.geometry import Pose
from diffbot_lab.demo.run_record import RunRecord

matplotlib.use("Agg")

import matplotlib.pyplot as plt

_BLUE, _ORANGE, _GREY, _GREEN, _RED = "#0072B2", "#E69F00", "#999999", "#009E73", "#D55E00"
"""Colours that people with any colour vision tell apart (Okabe, Ito)."""


def draw_run(record: RunRecord, title: str, path: Path) -> None:
    """Draw truth, estimate, odometry, fixes and goals of a run as a PNG of 1200 x 1000 pixels.

    Raises:
        OSError: if the file cannot be written.
    """
    figure, axes = plt.subplots(figsize=(8.0, 20.0 / 3.0), dpi=150, layout="constrained")
    axes.plot(
        record.fixes[:, 1],
        record.fixes[:, 2],
        ".",
        color=_GREY,
        markersize=2.5,
        alpha=0.6,
        label="fixes (global_pose)",
    )
    axes.plot(
        record.odometry[:, 1],
        record.odometry[:, 2],
        "--",
        color=_ORANGE,
        linewidth=1.2,
        label="odometry alone",
    )
    axes.plot(record.truth[:, 1], record.truth[:, 2], color=_BLUE, linewidth=2.6, label="truth")
    axes.plot(
        record.estimate[:, 1],
        record.estimate[:, 2],
        color=_RED,
        linewidth=0.9,
        label="estimate (EKF)",
    )
    span = max(float(np.ptp(record.truth[:, 1])), float(np.ptp(record.truth[:, 2])), 1.0)
    start = Pose(*record.truth[0, 1:].tolist())
    _arrow(axes, start, 0.07 * span, _BLUE, "start")
    for number, (_, goal) in enumerate(record.goals, 1):
        _arrow(axes, goal, 0.07 * span, _GREEN, f"goal {number}")
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    axes.set_title(title)
    axes.grid(alpha=0.3)
    axes.legend(loc="best", fontsize="small")
    save(figure, path)


def _arrow(axes: Any, pose: Pose, length: float, colour: str, text: str) -> None:
    axes.plot([pose.x], [pose.y], "o", color=colour, markersize=6, zorder=5)
    axes.annotate(
        "",
        (pose.x + length * np.cos(pose.theta), pose.y + length * np.sin(pose.theta)),
        (pose.x, pose.y),
        arrowprops={"arrowstyle": "-|>", "color": colour, "linewidth": 2.0},
        zorder=5,
    )
    axes.annotate(text, (pose.x, pose.y), xytext=(6, -12), textcoords="offset points", color=colour, zorder=6)


def new_figure(rows: int, size: tuple[float, float], *, sharex: bool = True) -> tuple[Any, Any]:
    """Return a figure of ``size`` [inch] with one axes (rows 1) or a list of axes above each other."""
    figure, axes = plt.subplots(rows, sharex=sharex, figsize=size, dpi=110, layout="constrained")
    for one in [axes] if rows == 1 else axes:
        one.grid(alpha=0.3)
    return figure, axes


def new_grid(
    columns: int, below: int, size: tuple[float, float], left: float = 0.04
) -> tuple[Any, list[Any], list[Any]]:
    """Return a figure of ``size`` [inch], a row of ``columns`` small axes and one of ``below`` larger ones.

    ``left`` is the share of the width that their labels take.
    """
    figure = plt.figure(figsize=size, dpi=100)
    upper = figure.add_gridspec(1, columns, left=left, right=0.99, bottom=0.56, top=0.94, wspace=0.08)
    lower = figure.add_gridspec(1, below, left=left, right=0.99, bottom=0.15, top=0.48, wspace=0.1)
    small = [figure.add_subplot(upper[0, index]) for index in range(columns)]
    large = [figure.add_subplot(lower[0, index]) for index in range(below)]
    for one in (*small, *large):
        one.grid(alpha=0.3)
    return figure, small, large


def save(figure: Any, *paths: Path) -> None:
    """Write a figure in one or more formats, each through a temporary name, so that no half a picture is ever seen."""
    for path in paths:
        part = path.with_name(f".{path.name}.part")
        figure.savefig(part, format=path.suffix[1:])
        os.replace(part, path)
    plt.close(figure)
