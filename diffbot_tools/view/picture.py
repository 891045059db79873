"""The picture of a robot's run: map and charts, as a whole or at the moment and view of a link copied from the page."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

from diffbot_tools.demo.figure import draw_paths
from diffbot_tools.demo.run_record import RunRecord
from diffbot_tools.plotting import BLUE, GREEN, ORANGE, RED, save
from diffbot_tools.view.moment import Moment
from diffbot_tools.view.report import RobotRun

Array = NDArray[np.float64]

_SIZE, _MAP, _DOTS = (14.4, 9.0), (780.0, 780.0), 100
"""[inch] of the picture; [pixels] of the map in it; [1/inch]"""
_SPEEDS = (("odometry", ORANGE), ("truth", BLUE), ("command", RED))


def draw_robot(robot: RobotRun, title: str, path: Path, moment: Moment) -> None:
    """Draw paths and goals of a robot until a moment, and its distance, heading error and speeds, as PNG.

    Raises:
        OSError: if the file cannot be written.
    """
    time = math.inf if moment.time is None else moment.time
    goals = [(goal.time, goal.pose) for goal in robot.goals]
    paths = [_path(robot, name) for name in ("truth", "estimate", "odometry", "fixes")]
    figure, axes = plt.subplot_mosaic(
        [["map", name] for name in ("distance [m]", "heading error [deg]", "v [m/s]", "omega [rad/s]")],
        figsize=_SIZE, dpi=_DOTS, layout="constrained", width_ratios=(3, 2),
    )  # fmt: skip
    ends = [max(int(np.searchsorted(one[:, 0], time, "right")), 1) for one in paths]
    truth, estimate, odometry, fixes = (one[:end] for one, end in zip(paths, ends, strict=True))
    record = RunRecord(truth, estimate, odometry, fixes, goals, 0, 0)
    draw_paths(axes["map"], record, title if moment.time is None else f"{title}, {time:.1f} s")
    if moment.view is not None:
        x, y, scale = moment.view
        width, height = (size / scale for size in _MAP)
        axes["map"].set_aspect("equal", adjustable="box")
        axes["map"].set(xlim=(x - width / 2, x + width / 2), ylim=(y - height / 2, y + height / 2))
    main = next(paths[at] for at in (1, 0, 2) if len(paths[at]))
    _draw_to_go(axes, main, goals)
    _draw_outline(axes["map"], robot, next(one for one in (estimate, truth, odometry) if len(one))[-1, 1:])
    for name, colour in _SPEEDS:
        if "v" in (columns := robot.curves.get(name, {})):
            axes["v [m/s]"].plot(columns["t"], columns["v"], color=colour, linewidth=1.0, label=name)
            axes["omega [rad/s]"].plot(columns["t"], columns["omega"], color=colour, linewidth=1.0)
    if axes["v [m/s]"].lines:
        axes["v [m/s]"].legend(loc="best", fontsize="small")
    for name, chart in axes.items():
        if name != "map":
            chart.set_title(name, fontsize="medium", loc="left")
            chart.set_xlim(moment.zoom or (main[0, 0], main[-1, 0] + 1e-3))
            chart.grid(alpha=0.3)
            if moment.time is not None:
                chart.axvline(time, color="black", linewidth=0.8)
    axes["omega [rad/s]"].set_xlabel("t [s]")
    save(figure, path)


def _draw_to_go(axes: dict[str, Any], main: Array, goals: list[Any]) -> None:
    """Draw distance and heading error to the newest goal; nothing before the first one."""
    poses = np.array([(math.nan,) * 3, *(pose for _, pose in goals)])
    goal = poses[np.searchsorted([time for time, _ in goals], main[:, 0], "right")]
    turn = main[:, 3] - goal[:, 2]
    axes["distance [m]"].plot(main[:, 0], np.hypot(*(main[:, 1:3] - goal[:, :2]).T), color=GREEN)
    axes["heading error [deg]"].plot(main[:, 0], np.degrees(np.arctan2(np.sin(turn), np.cos(turn))), color=GREEN)


def _draw_outline(axes: Any, robot: RobotRun, pose: Array) -> None:
    """Draw the robot's box, else the circle through its wheels, and a line to its front; nothing without its size."""
    if robot.box is None and robot.wheels is None:
        return
    angles = np.linspace(0.0, 2.0 * math.pi, 61)
    outline = np.exp(1j * angles) * (robot.wheels.wheel_separation / 2.0 if robot.wheels else 0.0)
    if robot.box is not None:
        rear, front, right, left = robot.box
        outline = np.array(
            [complex(x, y) for x, y in ((front, left), (rear, left), (rear, right), (front, right), (front, left))]
        )
    points = complex(pose[0], pose[1]) + np.exp(1j * pose[2]) * np.concatenate(
        ([outline.real.max(), 0.0, math.nan], outline)
    )
    axes.plot(points.real, points.imag, color=RED, linewidth=1.5)


def _path(robot: RobotRun, name: str) -> Array:
    columns = robot.curves.get(name)
    if columns is None:
        return np.empty((0, 4))
    return np.column_stack([columns[one] for one in ("t", "x", "y", "theta")])
