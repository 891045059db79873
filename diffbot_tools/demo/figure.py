"""The picture of a demonstration: truth, estimate, odometry, fixes and goals."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np

from diffbot_core.geometry import Pose
from diffbot_tools.demo.run_record import RunRecord
from diffbot_tools.plotting import BLUE, GREEN, GREY, ORANGE, RED, save

_STYLES: dict[str, dict[str, Any]] = {
    "fixes": {
        "label": "fixes (global_pose)",
        "color": GREY,
        "marker": ".",
        "markersize": 2.5,
        "linestyle": "",
        "alpha": 0.6,
    },
    "odometry": {"label": "odometry alone", "color": ORANGE, "linestyle": "--", "linewidth": 1.2},
    "truth": {"label": "truth", "color": BLUE, "linewidth": 2.6},
    "estimate": {"label": "estimate (EKF)", "color": RED, "linewidth": 0.9},
}
"""Paths of a RunRecord, in the order of drawing."""


def draw_run(record: RunRecord, title: str, path: Path) -> None:
    """Draw truth, estimate, odometry, fixes and goals of a run as a PNG of 1200 x 1000 pixels; paths may be empty.

    Raises:
        OSError: if the file cannot be written.
    """
    figure, axes = plt.subplots(figsize=(8.0, 20.0 / 3.0), dpi=150, layout="constrained")
    for name, style in _STYLES.items():
        path_xy = getattr(record, name)[:, 1:3]
        if len(path_xy):
            axes.plot(*path_xy.T, **style)
    main = next(path for path in (record.truth, record.estimate, record.odometry) if len(path))
    span = max(float(np.ptp(main[:, 1])), float(np.ptp(main[:, 2])), 1.0)
    start = Pose(*main[0, 1:].tolist())
    _arrow(axes, start, 0.07 * span, BLUE, "start")
    for number, (_, goal) in enumerate(record.goals, 1):
        _arrow(axes, goal, 0.07 * span, GREEN, f"goal {number}")
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
