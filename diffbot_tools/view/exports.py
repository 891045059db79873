"""Beside the report: a table (CSV) and trajectories (TUM, as evo reads them)."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from diffbot_core.errors import DiffbotError
from diffbot_core.files import write_text
from diffbot_core.geometry import quaternion_of_yaw
from diffbot_tools.view.clock import Columns
from diffbot_tools.view.report import BagRun, RobotRun

Array = NDArray[np.float64]

CURVES = ("estimate", "truth", "odometry", "error", "command", "law")
"""in the table, each with its columns"""
PATHS = ("truth", "estimate", "odometry")


def export(run: BagRun, report: Path, csv: bool, tum: bool) -> list[Path]:
    """Write what is asked for beside ``report``, with its name; return the files.

    Raises:
        DiffbotError: if two robots have names that make one file name.
        OSError: if a file cannot be written.
    """
    written: list[Path] = []
    several = len(run.robots) > 1
    for robot in run.robots:
        stem = f"{report.stem}_{_file_name(robot.name)}" if several else report.stem
        if csv:
            written.append(report.with_name(f"{stem}.csv"))
            write_text(written[-1], csv_text(robot))
        for name in PATHS if tum else ():
            if name in robot.curves:
                written.append(report.with_name(f"{stem}_{name}.tum"))
                write_text(written[-1], tum_text(robot.curves[name], run.clock.origin))
    if len({path.name for path in written}) < len(written):
        raise DiffbotError("two robots of the bag have names that make one file name")
    return written


def csv_text(robot: RobotRun) -> str:
    """Return a table with a row per estimate (else odometry, else true pose), at its time.

    The other curves are held: their last value at that time; empty before their first.
    """
    base = next(robot.curves[name] for name in ("estimate", "odometry", "truth") if name in robot.curves)
    times = base["t"]
    names, columns = ["t"], [times]
    for curve in CURVES:
        if curve not in robot.curves:
            continue
        source = robot.curves[curve]
        held = np.searchsorted(source["t"], times + 1e-6, "right") - 1
        for name, values in source.items():
            if name != "t":
                names.append(f"{curve}.{name}")
                columns.append(np.where(held >= 0, values[np.maximum(held, 0)], np.nan))
    text = io.StringIO()
    np.savetxt(text, np.column_stack(columns), fmt="%.9g", delimiter=",", header=",".join(names), comments="")
    return text.getvalue().replace("nan", "")


def tum_text(path: Columns, origin: int) -> str:
    """Return lines ``stamp x y z qx qy qz qw``; stamps [s] are those of the messages, ``origin`` [ns] that of t = 0."""
    lines = []
    rows = zip(*(path[name].tolist() for name in ("t", "x", "y", "theta")), strict=True)
    for t, x, y, theta in rows:
        stamp = origin + round(t * 1e9)
        z, w = quaternion_of_yaw(theta)
        lines.append(f"{stamp // 10**9}.{stamp % 10**9:09d} {x:.9g} {y:.9g} 0 0 0 {z:.9g} {w:.9g}")
    return "\n".join(lines) + "\n"


def _file_name(robot: str) -> str:
    return "".join(character if character.isalnum() else "_" for character in robot)[:80]
