"""One recorded drive of a real robot, as all data sets are read."""

from __future__ import annotations

import bisect
import math
from collections.abc import Mapping
from typing import NamedTuple

from diffbot_control.ros.messages.landmark_cloud import LandmarkPoint
from diffbot_core.errors import DiffbotError
from diffbot_core.geometry import Point, Pose, wrap_angle
from diffbot_core.kinematics import Twist
from diffbot_core.units import S_PER_NS

MAX_TRUTH_GAP = 500_000_000
"""[ns] between true poses; none is interpolated in a longer gap"""
UNKNOWN_HEADING = math.pi / math.sqrt(3.0)
"""[rad] standard deviation of a heading about which nothing is known"""


class Measured(NamedTuple):
    """A twist and its stamp [ns]."""

    stamp: int
    twist: Twist


class Cloud(NamedTuple):
    """Landmarks measured at one time [ns], none of them twice."""

    stamp: int
    points: list[LandmarkPoint]


class TruePose(NamedTuple):
    """A pose of the reference system; its heading is nan if the system measures none."""

    stamp: int
    """[ns]"""
    pose: Pose


class Drive(NamedTuple):
    """Everything recorded in one drive, each list in the order of its stamps."""

    name: str
    odometry: list[Measured]
    clouds: list[Cloud]
    truth: list[TruePose]
    landmarks: dict[int, Point]
    start_sigmas: tuple[float, float]
    """[m], [rad] standard deviations of the pose with which the filter starts"""
    parameters: Mapping[str, object]
    """of the node ``ekf``, for this kind of robot"""
    notes: list[str]
    """what was left out of the files, for the user"""


def start_of(drive: Drive) -> tuple[int, Pose]:
    """Return the stamp [ns] of the first odometry that has a true pose, and that pose; an unknown heading is 0.

    Raises:
        DiffbotError: if no odometry has one.
    """
    stamps = [one.stamp for one in drive.truth]
    for stamp, _ in drive.odometry:
        pose = true_pose_at(drive.truth, stamps, stamp)
        if pose is not None:
            return stamp, pose if math.isfinite(pose.theta) else pose._replace(theta=0.0)
    raise DiffbotError(f"{drive.name}: no odometry at a time with a true pose")


def true_pose_at(truth: list[TruePose], stamps: list[int], stamp: int) -> Pose | None:
    """Interpolate the true pose at ``stamp`` [ns]; None outside ``stamps``, those of ``truth``, and in a long gap."""
    after = bisect.bisect_left(stamps, stamp)
    if after < len(stamps) and stamps[after] == stamp:
        return truth[after].pose
    if not 0 < after < len(stamps) or stamps[after] - stamps[after - 1] > MAX_TRUTH_GAP:
        return None
    first, last = truth[after - 1].pose, truth[after].pose
    share = (stamp - stamps[after - 1]) / (stamps[after] - stamps[after - 1])
    turn = share * wrap_angle(last.theta - first.theta)
    return Pose(
        first.x + share * (last.x - first.x), first.y + share * (last.y - first.y), wrap_angle(first.theta + turn)
    )


def clouds_of(measured: list[tuple[int, LandmarkPoint]]) -> list[Cloud]:
    """Group landmarks in the order of their stamps [ns]; a landmark that repeats at one stamp begins another cloud."""
    found: list[Cloud] = []
    for stamp, point in sorted(measured, key=lambda one: one[0]):
        if not found or found[-1].stamp != stamp or any(one.number == point.number for one in found[-1].points):
            found.append(Cloud(stamp, []))
        found[-1].points.append(point)
    return found


def in_order(odometry: list[Measured], notes: list[str]) -> list[Measured]:
    """Return the odometry ordered by stamps, the first of those with equal stamps; ``notes`` gets their number."""
    found: list[Measured] = []
    for one in sorted(odometry, key=lambda one: one.stamp):
        if not found or found[-1].stamp < one.stamp:
            found.append(one)
    if len(found) < len(odometry):
        notes.append(f"{len(odometry) - len(found)} of {len(odometry)} odometry lines repeat a time: left out")
    return found


def duration(drive: Drive) -> float:
    """Time [s] from the first to the last odometry."""
    return (drive.odometry[-1].stamp - drive.odometry[0].stamp) * S_PER_NS
