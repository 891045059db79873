"""Messages to CDR and back without ROS: mcap-ros2-support for any type, a short cut for the two frequent ones.

mcap-ros2-support needs 0.2 to 0.3 ms to encode a pose with its 36 numbers. A nav_msgs/Odometry and a
geometry_msgs/PoseWithCovarianceStamped are a stamp, one or two strings and then only numbers (float64) to the end, so
that they can be written and read as one block. A test holds the short cut to mcap-ros2-support's bytes.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

import numpy as np
from mcap_ros2._dynamic import serialize_dynamic
from numpy.typing import NDArray

from diffbot_bag.bag.message_definitions import MessageDefinitions
from diffbot_core.cdr import HEADER, CdrError, read_odometry, read_pose
from diffbot_core.units import NS_PER_S

ODOMETRY = "nav_msgs/msg/Odometry"
POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"
_STRINGS = {ODOMETRY: 2, POSE: 1}
"""Strings between stamp and numbers: frame_id, and child_frame_id of an odometry."""
_NUMBERS = {ODOMETRY: 85, POSE: 43}
"""A pose (7) with covariance (36), and for an odometry a twist (6) with covariance (36)."""
_STAMP = struct.Struct("<iI")
_LENGTH = struct.Struct("<I")


class Encoder:
    """Encodes messages, which are anything with their fields as attributes or as keys; missing fields are zero."""

    def __init__(self, definitions: MessageDefinitions | None = None) -> None:
        """Take the definitions of the types from the installed interface packages, or from ``definitions``."""
        self._definitions = definitions or MessageDefinitions()
        self._functions: dict[str, Callable[[Any], bytes]] = {}

    def encode(self, type_name: str, message: Any) -> bytes:
        """Return the CDR bytes of a message of ``pkg/msg/Type``.

        Raises:
            DefinitionNotFoundError: if the type is not installed.
        """
        if type_name not in self._functions:
            text = self._definitions.schema_text(type_name)
            self._functions[type_name] = serialize_dynamic(type_name, text)[type_name]
        return self._functions[type_name](message)


class NumbersMessage:
    """A message of type ODOMETRY or POSE that is filled repeatedly: constant frames, a stamp and its numbers.

    ``numbers`` is in the order of the definition: position x y z, orientation x y z w, 36 of the pose's covariance; an
    odometry goes on with the linear velocity x y z, the angular one, and 36 of their covariance. The attributes are
    views on its parts.
    """

    def __init__(self, type_name: str, frame: str, child_frame: str = "") -> None:
        """Start with all numbers zero but the orientation's w; an unused ``child_frame`` is ignored."""
        self.type = type_name
        self.numbers: NDArray[np.float64] = np.zeros(_NUMBERS[type_name])
        self.numbers[6] = 1.0
        self.position, self.orientation = self.numbers[:3], self.numbers[3:7]
        self.pose_covariance = self.numbers[7:43]
        self.twist, self.twist_covariance = self.numbers[43:49], self.numbers[49:]
        body = bytearray(_STAMP.size)
        for text in (frame, child_frame)[: _STRINGS[type_name]]:
            body += bytes(-len(body) % 4)
            encoded = text.encode() + b"\0"
            body += _LENGTH.pack(len(encoded)) + encoded
        self._prefix = bytearray(HEADER) + body + bytes(-len(body) % 8)

    def encode(self, stamp: int) -> bytes:
        """Return the CDR bytes of the message with this stamp [ns]."""
        _STAMP.pack_into(self._prefix, len(HEADER), *divmod(stamp, NS_PER_S))
        return bytes(self._prefix) + self.numbers.tobytes()


_READERS: dict[str, Callable[[bytes], Any]] = {ODOMETRY: read_odometry, POSE: read_pose}


def decode_numbers_message(type_name: str, data: bytes) -> Any | None:
    """Decode a message of type ODOMETRY or POSE; None if it is of another type, or not in plain CDR."""
    if type_name not in _READERS:
        return None
    try:
        return _READERS[type_name](data)
    except CdrError:
        return None
