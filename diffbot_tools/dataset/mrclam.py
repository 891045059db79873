"""MR.CLAM: the UTIAS Multi-Robot Cooperative Localization and Mapping data set (Leung et al., IJRR 30, 2011, 969-974).

Its "range" is the depth along the camera's axis: with range = depth / cos(bearing) the scatter of the range error in
set 7 falls from 0.14 .. 0.21 m to 0.03 .. 0.07 m.
"""

from __future__ import annotations

import math
from pathlib import Path

from diffbot_control.ros.messages.landmark_cloud import LandmarkPoint
from diffbot_core.geometry import MAX_COORDINATE, Point, Pose, wrap_angle
from diffbot_core.kinematics import Twist
from diffbot_tools.dataset.drive import Drive, Measured, TruePose, clouds_of, in_order
from diffbot_tools.dataset.number_file import DataError, table
from diffbot_tools.dataset.shipped import MRCLAM

ROBOTS = range(1, 6)
"""Subjects 1 to 5 are the robots themselves; the landmarks follow."""
START_SIGMAS = 0.01, 0.01
_MAX_SPEED, _MAX_ANGLE, _MAX_BEARING = 1e4, 1e3, 1.5
"""[m/s] and [rad/s]; [rad] of headings; [rad] half of the field of view of any camera with a depth"""


def robots_in(folder: Path) -> list[int]:
    """Return the numbers of the robots with an odometry file in the folder."""
    return [robot for robot in ROBOTS if (folder / f"Robot{robot}_Odometry.dat").is_file()]


def read_mrclam(folder: Path, robot: int) -> Drive:
    """Read one robot's drive from the text files of a set.

    Raises:
        DataError: for a missing file or a bad line, with file, line and value.
    """
    notes: list[str] = []
    landmarks = _landmarks(folder / "Landmark_Groundtruth.dat")
    subjects = _subjects(folder / "Barcodes.dat")
    odometry = held(in_order(_odometry(folder / f"Robot{robot}_Odometry.dat"), notes))
    measured = _measurements(folder / f"Robot{robot}_Measurement.dat", subjects, landmarks, notes)
    truth = _truth(folder / f"Robot{robot}_Groundtruth.dat")
    return Drive(
        f"{folder.name} robot {robot}", odometry, clouds_of(measured), truth, landmarks, START_SIGMAS, MRCLAM, notes
    )


def held(commands: list[Measured]) -> list[Measured]:
    """Turn commands, each of which holds until the next, into mean twists over the time before each stamp.

    The log has gaps of up to 1.4 s in which a robot turns by half a radian; nothing is known from before the first one.
    """
    twists = [commands[0].twist, *(one.twist for one in commands)]
    return [Measured(one.stamp, twist) for one, twist in zip(commands, twists, strict=False)]


def _landmarks(path: Path) -> dict[int, Point]:
    found: dict[int, Point] = {}
    for row in table(path, 5):
        subject = row.whole(0, "subject")
        if subject in found:
            raise row.error(f"subject {subject} is in the file twice")
        x, y = (row.number(1 + index, name, -MAX_COORDINATE, MAX_COORDINATE) for index, name in enumerate("xy"))
        found[subject] = Point(x, y)
    return found


def _subjects(path: Path) -> dict[int, int]:
    """Map each barcode to its subject."""
    found: dict[int, int] = {}
    for row in table(path, 2):
        barcode = row.whole(1, "barcode")
        if barcode in found:
            raise row.error(f"barcode {barcode} is in the file twice")
        found[barcode] = row.whole(0, "subject")
    return found


def _odometry(path: Path) -> list[Measured]:
    found = [
        Measured(
            row.stamp(0),
            Twist(
                row.number(1, "velocity", -_MAX_SPEED, _MAX_SPEED),
                row.number(2, "angular velocity", -_MAX_SPEED, _MAX_SPEED),
            ),
        )
        for row in table(path, 3)
    ]
    if not found:
        raise DataError(f"{path} has no odometry")
    return found


def _measurements(
    path: Path, subjects: dict[int, int], landmarks: dict[int, Point], notes: list[str]
) -> list[tuple[int, LandmarkPoint]]:
    """Return the measured landmarks with their stamps [ns]; their variances are unknown (0)."""
    found: dict[tuple[int, LandmarkPoint], None] = {}  # in the order of the file, without exact repetitions
    total = robots = unknown = 0
    for row in table(path, 4):
        stamp, barcode = row.stamp(0), row.whole(1, "barcode")
        depth = row.number(2, "range", 1e-3, MAX_COORDINATE)
        bearing = row.number(3, "bearing", -_MAX_BEARING, _MAX_BEARING)
        subject = subjects.get(barcode, 0)
        total += 1
        if subject in ROBOTS:
            robots += 1
        elif subject not in landmarks:
            unknown += 1
        else:
            point = LandmarkPoint(subject, depth / math.cos(bearing), bearing, 0.0, 0.0)
            found[stamp, point] = None
    repeated = total - robots - unknown - len(found)
    for count, what in ((robots, "are of robots"), (unknown, "have an unknown barcode"), (repeated, "are repetitions")):
        if count:
            notes.append(f"{count} of {total} measurements {what}: left out")
    return list(found)


def _truth(path: Path) -> list[TruePose]:
    found: dict[int, TruePose] = {}
    for row in table(path, 4):
        x, y = (row.number(1 + index, name, -MAX_COORDINATE, MAX_COORDINATE) for index, name in enumerate("xy"))
        theta = wrap_angle(row.number(3, "orientation", -_MAX_ANGLE, _MAX_ANGLE))
        stamp = row.stamp(0)
        found[stamp] = TruePose(stamp, Pose(x, y, theta))
    return sorted(found.values())
