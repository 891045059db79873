"""The Labyrinth data set (T. Pfeifer, TU Chemnitz): wheel speeds, ranges to radio modules, true positions."""

from __future__ import annotations

import math
from pathlib import Path

from diffbot_control.ros.messages.landmark_cloud import LandmarkPoint
from diffbot_core.geometry import MAX_COORDINATE, Point, Pose
from diffbot_core.kinematics import Twist
from diffbot_tools.dataset.drive import UNKNOWN_HEADING, Drive, Measured, TruePose, clouds_of, in_order
from diffbot_tools.dataset.number_file import DataError, Row, rows
from diffbot_tools.dataset.shipped import LABYRINTH

INPUT, TRUTH = "Indoor_UWB_Input.txt", "Indoor_UWB_GT.txt"
START_SIGMAS = 0.1, UNKNOWN_HEADING
_COLUMNS = {"range2": 8, "odom2diff": 9, "point2": 8}
"""Number of words in a line of each kind, its name included."""
_MAX_SPEED = 1e4


def read_labyrinth(folder: Path) -> Drive:
    """Read the drive from its two text files.

    Ranges become landmarks whose bearing is 0 with an infinite variance: not measured.

    Raises:
        DataError: for a missing file or a bad line, with file, line and value.
    """
    notes: list[str] = []
    modules: dict[int, Point] = {}
    measured: list[tuple[int, LandmarkPoint]] = []
    odometry: list[Measured] = []
    separations: set[float] = set()
    for row in rows(folder / INPUT):
        if _kind(row, ("range2", "odom2diff")) == "range2":
            measured.append((row.stamp(1), _range(row, modules)))
        else:
            odometry.append(_odometry(row, separations))
    if not odometry:
        raise DataError(f"{folder / INPUT} has no odometry")
    truth = {one.stamp: one for one in map(_truth, rows(folder / TRUTH))}
    parameters = {"wheel_separation": separations.pop(), **LABYRINTH}
    return Drive(
        "labyrinth",
        in_order(odometry, notes),
        clouds_of(measured),
        sorted(truth.values()),
        modules,
        START_SIGMAS,
        parameters,
        notes,
    )


def _kind(row: Row, allowed: tuple[str, ...]) -> str:
    """Return the kind of a line, whose number of words is right."""
    kind = row.words[0]
    if kind not in allowed:
        raise row.error(f"{kind[:40]!r} must be one of {', '.join(allowed)}")
    if len(row.words) != _COLUMNS[kind]:
        raise row.error(f"{_COLUMNS[kind]} columns expected, {len(row.words)} found")
    return kind


def _range(row: Row, modules: dict[int, Point]) -> LandmarkPoint:
    distance = row.number(2, "range", 1e-3, MAX_COORDINATE)
    variance = row.number(3, "range covariance", 0.0, MAX_COORDINATE)
    x, y = (row.number(index, "position", -MAX_COORDINATE, MAX_COORDINATE) for index in (4, 5))
    number = row.whole(6, "module")
    if modules.setdefault(number, Point(x, y)) != Point(x, y):
        raise row.error(f"module {number} is at {x:g}, {y:g}, but elsewhere in an earlier line")
    return LandmarkPoint(number, distance, 0.0, variance, math.inf)


def _odometry(row: Row, separations: set[float]) -> Measured:
    right, left = (row.number(index, "wheel velocity", -_MAX_SPEED, _MAX_SPEED) for index in (2, 3))
    separation = row.number(5, "distance between wheels", 1e-3, 1e3)
    separations.add(separation)
    if len(separations) > 1:
        raise row.error(f"distance between wheels {separation:g} differs from that of an earlier line")
    return Measured(row.stamp(1), Twist(0.5 * (right + left), (right - left) / separation))


def _truth(row: Row) -> TruePose:
    _kind(row, ("point2",))
    x, y = (row.number(index, "position", -MAX_COORDINATE, MAX_COORDINATE) for index in (2, 3))
    return TruePose(row.stamp(1), Pose(x, y, math.nan))
