"""Messages of raw subscriptions: read from their bytes, or by rclpy if they are in an encoding of their own."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from rclpy.serialization import deserialize_message

from diffbot_core import cdr
from diffbot_core.errors import BadMessageError


def read_odometry(data: bytes) -> Any:
    """Return something with the fields of an Odometry.

    Raises:
        BadMessageError: if the bytes are none.
    """
    return _read(cdr.read_odometry, data, Odometry)


def read_pose(data: bytes) -> Any:
    """Return something with the fields of a PoseWithCovarianceStamped.

    Raises:
        BadMessageError: if the bytes are none.
    """
    return _read(cdr.read_pose, data, PoseWithCovarianceStamped)


def _read(reader: Callable[[bytes], Any], data: bytes, message_type: Any) -> Any:
    try:
        return reader(data)
    except cdr.CdrError:
        pass
    try:
        return deserialize_message(data, message_type)
    except Exception as error:  # rclpy's own types, ValueError, MemoryError: all are about the bytes
        raise BadMessageError("message cannot be read", " ".join(str(error).split())) from None


def read_path(data: bytes) -> cdr.PathFields:
    """Return the fields of a Path, of which the poses are read only as they are asked for.

    Raises:
        BadMessageError: if the bytes are no Path in plain CDR; also by the iterator of its poses.
    """
    try:
        path = cdr.read_path(data)
    except cdr.CdrError as error:
        raise BadMessageError("path cannot be read", str(error)) from None
    return path._replace(poses=_checked(path.poses))


def _checked(poses: Any) -> Any:
    try:
        yield from poses
    except cdr.CdrError as error:
        raise BadMessageError("path cannot be read", str(error)) from None
