"""The picture of a robot's run, as the demonstration draws it, from whatever paths the bag has."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from diffbot_tools.demo.figure import draw_run
from diffbot_tools.demo.run_record import RunRecord
from diffbot_tools.view.report import RobotRun

Array = NDArray[np.float64]


def draw_robot(robot: RobotRun, title: str, path: Path) -> None:
    """Draw the paths and goals of a robot as PNG.

    Raises:
        OSError: if the file cannot be written.
    """
    goals = [(goal.time, goal.pose) for goal in robot.goals]
    truth, estimate, odometry, fixes = (_path(robot, name) for name in ("truth", "estimate", "odometry", "fixes"))
    draw_run(RunRecord(truth, estimate, odometry, fixes, goals, 0, 0), title, path)


def _path(robot: RobotRun, name: str) -> Array:
    columns = robot.curves.get(name)
    if columns is None:
        return np.empty((0, 4))
    return np.column_stack([columns[one] for one in ("t", "x", "y", "theta")])
