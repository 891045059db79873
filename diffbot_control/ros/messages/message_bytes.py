"""Odometry, PoseWithCovarianceStamped and Path as DDS carries them, read without making the message.

rclpy spends about 0.3 ms of a 50 Hz step on the Python objects of such a message, most of them never looked at. A
subscription with ``raw=True`` gives the bytes; this module reads what the nodes use of them. A Path is read pose by
pose, so that a long one need not be read at once: rclpy would take 0.3 s for 10,000 poses.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import Any, NamedTuple

from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from rclpy.serialization import deserialize_message

from diffbot_core.errors import BadMessageError

_LITTLE_ENDIAN = b"\x00\x01"
"""First bytes of the encapsulation header of plain CDR, in which all common middlewares send messages."""
_HEADER = 4
"""Bytes of that header; CDR aligns relative to its end."""
_STAMP = struct.Struct("<iI")
_LENGTH = struct.Struct("<I")
_STAMP_BIG, _LENGTH_BIG = struct.Struct(">iI"), struct.Struct(">I")
_ODOMETRY = struct.Struct("<85d")
"""Pose (7), its covariance (36), twist (6), its covariance (36)."""
_POSE = struct.Struct("<43d")
"""Pose (7), its covariance (36)."""

_BYTE_ORDERS = {b"\x00\x00": ">", _LITTLE_ENDIAN: "<"}
"""Of plain CDR."""


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
    """reads the poses one by one; raises BadMessageError where the bytes end or are no pose"""


def read_odometry(data: bytes) -> Any:
    """Return something with the fields of an Odometry; the message itself if its encoding is not the usual one.

    Raises:
        BadMessageError: if the bytes are no Odometry.
    """
    try:
        header, end = _little_endian_header(data)
        child_frame, end = _text(data, end)
        return OdometryFields(header, child_frame, _ODOMETRY.unpack_from(data, _aligned(end, 8)))
    except (struct.error, ValueError):
        return _message_of(data, Odometry)


def read_pose(data: bytes) -> Any:
    """Return the same for a PoseWithCovarianceStamped."""
    try:
        header, end = _little_endian_header(data)
        return PoseStampedFields(header, _pose_of(_POSE.unpack_from(data, _aligned(end, 8))))
    except (struct.error, ValueError):
        return _message_of(data, PoseWithCovarianceStamped)


def _message_of(data: bytes, message_type: Any) -> Any:
    try:
        return deserialize_message(data, message_type)
    except Exception as error:  # rclpy's own types, ValueError, MemoryError: all are about the bytes
        raise BadMessageError("message cannot be read", " ".join(str(error).split())) from None


def read_path(data: bytes) -> PathFields:
    """Return the fields of a Path, of which the poses are read only as they are asked for.

    Raises:
        BadMessageError: if the bytes are no Path in plain CDR.
    """
    order = _BYTE_ORDERS.get(bytes(data[:2]))
    if order is None:
        raise BadMessageError("path in an unknown encoding", data[:2].hex())
    try:
        header, end = _header(data, _HEADER, order)
        end = _aligned(end, 4)
        (length,) = struct.unpack_from(order + "I", data, end)
    except (struct.error, ValueError) as error:
        raise BadMessageError("path cannot be read", str(error)) from None
    return PathFields(header, length, _poses_of_path(data, end + 4, length, order))


def _poses_of_path(data: bytes, end: int, length: int, order: str) -> Iterator[PathPose]:
    numbers = struct.Struct(order + "7d")
    for _ in range(length):
        try:
            header, end = _header(data, _aligned(end, 4), order)
            start = _aligned(end, 8)
            x, y, z, *quaternion = numbers.unpack_from(data, start)
        except (struct.error, ValueError) as error:
            raise BadMessageError("path cannot be read", str(error)) from None
        end = start + numbers.size
        yield PathPose(header, Pose(Vector(x, y, z), Quaternion(*quaternion)))


def _pose_of(n: tuple[float, ...]) -> PoseWithCovariance:
    return PoseWithCovariance(Pose(Vector(*n[:3]), Quaternion(*n[3:7])), n[7:43])


def _little_endian_header(data: bytes) -> tuple[Header, int]:
    """Return the header that a message begins with, and its end."""
    if data[:2] != _LITTLE_ENDIAN:
        raise ValueError("not little-endian CDR")
    return _header(data)


def _header(data: bytes, start: int = _HEADER, order: str = "<") -> tuple[Header, int]:
    """Return the header at ``start``, and its end."""
    stamp, length = (_STAMP, _LENGTH) if order == "<" else (_STAMP_BIG, _LENGTH_BIG)
    frame, end = _text(data, start + stamp.size, length)
    return Header(Stamp(*stamp.unpack_from(data, start)), frame), end


def _text(data: bytes, start: int, length_type: struct.Struct = _LENGTH) -> tuple[str, int]:
    """Return the text whose length stands at or after ``start``, without its final zero, and the end of it."""
    start = _aligned(start, 4)
    (length,) = length_type.unpack_from(data, start)
    first = start + length_type.size
    return data[first : first + length - 1].decode(), first + length


def _aligned(place: int, size: int) -> int:
    """Return the first multiple of ``size`` at or after ``place``, counted from the end of the encapsulation header."""
    return _HEADER - (_HEADER - place) // size * size
