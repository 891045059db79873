"""Messages from their bytes, as DDS carries them and bags keep them: plain CDR, read without ROS.

rclpy spends about 0.3 ms of a 50 Hz step on the Python objects of an odometry or a pose, most of them never looked at;
a node that subscribes with ``raw=True`` reads what it uses here (a quarter of robot_node's CPU otherwise). A Path is
read pose by pose, so that a long one need not be read at once.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from functools import cache
from typing import NamedTuple

HEADER = b"\x00\x01\x00\x00"
"""Encapsulation header of plain little-endian CDR, which all common middlewares send; alignment counts from its end."""
MAX_ITEMS = 100_000
"""of a sequence: a message of unknown origin can claim any number"""
_ORDERS = {b"\x00\x00": ">", HEADER[:2]: "<"}
_ODOMETRY, _POSE = 85, 43
"""Numbers: a pose (7) with covariance (36), and for an odometry a twist (6) with covariance (36)."""


class CdrError(ValueError):
    """The bytes are no message of this type."""


@cache
def _layout(order: str, form: str) -> struct.Struct:
    return struct.Struct(order + form)


class CdrCursor:
    """Reads the fields of one message in order; every method raises CdrError where the bytes end."""

    def __init__(self, data: bytes) -> None:
        """Begin after the encapsulation header."""
        order = _ORDERS.get(bytes(data[:2]))
        if order is None or len(data) < len(HEADER):
            raise CdrError(f"not in plain CDR: {bytes(data[:2]).hex()}")
        self._data, self._at, self._order = data, len(HEADER), order

    @property
    def place(self) -> int:
        """Index of the next byte."""
        return self._at

    def align(self, size: int) -> int:
        """Move to the next multiple of ``size`` and return its index."""
        self._at += -(self._at - len(HEADER)) % size
        return self._at

    def byte(self) -> int:
        """Read one byte."""
        if self._at >= len(self._data):
            raise CdrError("truncated")
        self._at += 1
        return self._data[self._at - 1]

    def uint32(self) -> int:
        """Read a number."""
        return int(self._unpack(4, "I")[0])

    def length(self) -> int:
        """Read the length of a sequence, at most MAX_ITEMS."""
        if (length := self.uint32()) > MAX_ITEMS:
            raise CdrError(f"{length} items")
        return length

    def stamp(self) -> int:
        """Read a time [ns]."""
        seconds, nanoseconds = self._unpack(4, "iI")
        return int(seconds) * 10**9 + int(nanoseconds)

    def header(self) -> Header:
        """Read a std_msgs/Header."""
        seconds, nanoseconds = self._unpack(4, "iI")
        return Header(Stamp(int(seconds), int(nanoseconds)), self.text())

    def doubles(self, count: int) -> tuple[float, ...]:
        """Read float64 numbers."""
        return self._unpack(8, f"{count}d")

    def text(self) -> str:
        """Read a text; bytes that are not UTF-8 are replaced."""
        length = self.uint32()
        end = self._at + length
        if end > len(self._data):
            raise CdrError("truncated")
        text = bytes(self._data[self._at : max(end - 1, self._at)]).decode("utf-8", "replace")
        self._at = end
        return text

    def finish(self) -> None:
        """Refuse a message that goes on; up to three bytes may pad it."""
        if len(self._data) - self._at >= 4:
            raise CdrError("too long")

    def _unpack(self, alignment: int, form: str) -> tuple[float, ...]:
        layout = _layout(self._order, form)
        try:
            found = layout.unpack_from(self._data, self.align(alignment))
        except struct.error as error:
            raise CdrError("truncated") from error
        self._at += layout.size
        return found


class Stamp(NamedTuple):
    """builtin_interfaces/Time."""

    sec: int
    nanosec: int


class Header(NamedTuple):
    """std_msgs/Header."""

    stamp: Stamp
    frame_id: str


class Vector(NamedTuple):
    """geometry_msgs/Vector3 or Point."""

    x: float
    y: float
    z: float


class Quaternion(NamedTuple):
    """geometry_msgs/Quaternion."""

    x: float
    y: float
    z: float
    w: float


class Pose(NamedTuple):
    """geometry_msgs/Pose."""

    position: Vector
    orientation: Quaternion


class PoseWithCovariance(NamedTuple):
    """geometry_msgs/PoseWithCovariance."""

    pose: Pose
    covariance: tuple[float, ...]


class Twist(NamedTuple):
    """geometry_msgs/Twist."""

    linear: Vector
    angular: Vector


class TwistWithCovariance(NamedTuple):
    """geometry_msgs/TwistWithCovariance."""

    twist: Twist
    covariance: tuple[float, ...]


class OdometryFields(NamedTuple):
    """nav_msgs/Odometry, as far as it is needed."""

    header: Header
    child_frame_id: str
    numbers: tuple[float, ...]
    """(85,) all numbers but the stamp, in the order of the message"""

    @property
    def pose(self) -> PoseWithCovariance:
        """Pose and covariance, which are only needed for TF."""
        return _pose_of(self.numbers)

    @property
    def twist(self) -> TwistWithCovariance:
        """Twist and covariance."""
        n = self.numbers
        return TwistWithCovariance(Twist(Vector(*n[43:46]), Vector(*n[46:49])), n[49:])


class PoseStampedFields(NamedTuple):
    """geometry_msgs/PoseWithCovarianceStamped."""

    header: Header
    pose: PoseWithCovariance


class PathPose(NamedTuple):
    """One geometry_msgs/PoseStamped of a path."""

    header: Header
    pose: Pose


class PathFields(NamedTuple):
    """nav_msgs/Path."""

    header: Header
    length: int
    """number of poses that the message claims to hold"""
    poses: Iterator[PathPose]
    """reads the poses one by one; raises CdrError where the bytes end or are no pose"""


def read_odometry(data: bytes) -> OdometryFields:
    """Return the fields of an Odometry.

    Raises:
        CdrError: if the bytes are none.
    """
    cursor = CdrCursor(data)
    found = OdometryFields(cursor.header(), cursor.text(), cursor.doubles(_ODOMETRY))
    cursor.finish()
    return found


def read_pose(data: bytes) -> PoseStampedFields:
    """Return the fields of a PoseWithCovarianceStamped.

    Raises:
        CdrError: if the bytes are none.
    """
    cursor = CdrCursor(data)
    found = PoseStampedFields(cursor.header(), _pose_of(cursor.doubles(_POSE)))
    cursor.finish()
    return found


def read_path(data: bytes) -> PathFields:
    """Return the fields of a Path, of which the poses are read only as they are asked for.

    Raises:
        CdrError: if the bytes are none.
    """
    cursor = CdrCursor(data)
    header, length = cursor.header(), cursor.uint32()
    return PathFields(header, length, _poses_of_path(cursor, length))


def _poses_of_path(cursor: CdrCursor, length: int) -> Iterator[PathPose]:
    for _ in range(length):
        header = cursor.header()
        x, y, z, *quaternion = cursor.doubles(7)
        yield PathPose(header, Pose(Vector(x, y, z), Quaternion(*quaternion)))


def _pose_of(n: tuple[float, ...]) -> PoseWithCovariance:
    return PoseWithCovariance(Pose(Vector(*n[:3]), Quaternion(*n[3:7])), n[7:43])
