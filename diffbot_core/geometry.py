"""Angles, planar poses and changes of frame."""

from __future__ import annotations

import math
from typing import NamedTuple

TWO_PI = 2.0 * math.pi
MAX_COORDINATE = 1e7
"""[m] Larger coordinates and ranges are refused (a quarter of the Earth's circumference is 1e7 m)."""


class Point(NamedTuple):
    """A position in some frame."""

    x: float
    """[m]"""
    y: float
    """[m]"""


class Pose(NamedTuple):
    """A planar pose in some frame."""

    x: float
    """[m]"""
    y: float
    """[m]"""
    theta: float
    """[rad]"""


def wrap_angle(angle: float) -> float:
    """Wrap an angle [rad] to (-pi, pi]; an angle in this range is returned unchanged."""
    if -math.pi < angle <= math.pi:
        return angle
    wrapped = angle % TWO_PI
    return wrapped - TWO_PI if wrapped > math.pi else wrapped


def into_frame(pose: Pose, frame: Pose) -> Pose:
    """Express ``pose`` in ``frame``; both are given in the same frame, e.g. a robot and its goal in ``map``."""
    dx = pose.x - frame.x
    dy = pose.y - frame.y
    c = math.cos(frame.theta)
    s = math.sin(frame.theta)
    return Pose(c * dx + s * dy, c * dy - s * dx, wrap_angle(pose.theta - frame.theta))


def out_of_frame(pose: Pose, frame: Pose) -> Pose:
    """Invert :func:`into_frame`: convert a ``pose`` given in ``frame`` to the frame in which ``frame`` is given."""
    c = math.cos(frame.theta)
    s = math.sin(frame.theta)
    x = frame.x + c * pose.x - s * pose.y
    y = frame.y + s * pose.x + c * pose.y
    return Pose(x, y, wrap_angle(pose.theta + frame.theta))


def origin_of_frame(inside: Pose, outside: Pose) -> Pose:
    """Return the origin of a frame, given one robot's pose ``inside`` the frame and its pose ``outside`` the frame.

    With the pose in ``odom`` and the pose in ``map``, the result is the pose of ``odom`` in ``map`` (REP-105).
    """
    return out_of_frame(into_frame(Pose(0.0, 0.0, 0.0), inside), outside)


def range_and_bearing(x: float, y: float, theta: float, point_x: float, point_y: float) -> tuple[float, float]:
    """Return range [m] and bearing [rad], not wrapped, of a point from a robot at ``x``, ``y``, ``theta``."""
    return math.hypot(point_x - x, point_y - y), math.atan2(point_y - y, point_x - x) - theta


def yaw_of_quaternion(x: float, y: float, z: float, w: float) -> float:
    """Return the yaw [rad] (ZYX convention) of a quaternion, which need not be normalised."""
    return math.atan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)


def quaternion_of_yaw(yaw: float) -> tuple[float, float]:
    """Return z and w of the unit quaternion for a rotation by ``yaw`` [rad] about the z axis; x and y are 0."""
    return math.sin(0.5 * yaw), math.cos(0.5 * yaw)
