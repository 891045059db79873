"""Fields of messages to values and back; a bad message raises BadMessageError.

Free of ROS: a message is anything with the fields of its type, from rclpy or decoded from a bag.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from diffbot_control.filter.covariance import check_covariance
from diffbot_control.filter.measurements import Array
from diffbot_core.errors import BadMessageError
from diffbot_core.geometry import MAX_COORDINATE, Pose, quaternion_of_yaw, yaw_of_quaternion
from diffbot_core.kinematics import Twist, TwistCovariance
from diffbot_core.units import NS_PER_S

MAX_SPEED = 1e4
"""[m/s], [rad/s] larger speeds are refused as errors."""

_MAX_SECONDS = 2.0**31 - 1.0

# Places of (x, y, yaw) in the row-major 6 x 6 covariance of REP-103's (x, y, z, roll, pitch, yaw).
_PLANAR = np.array([0, 1, 5, 6, 7, 11, 30, 31, 35])


def stamp_ns(stamp: Any) -> int:
    """Return a stamp as nanoseconds; it is copied to answers, so it must be one that :func:`set_stamp` can write."""
    if stamp.nanosec >= NS_PER_S:
        raise BadMessageError("stamp not normalised", f"{stamp.nanosec} ns")
    return int(stamp.sec) * NS_PER_S + int(stamp.nanosec)


def set_stamp(stamp: Any, nanoseconds: int) -> None:
    """Write nanoseconds into a stamp in place."""
    stamp.sec, stamp.nanosec = divmod(nanoseconds, NS_PER_S)


def fill_duration(duration: Any, seconds: float) -> None:
    """Write a time [s] into a Duration in place, cut to what it can hold."""
    nanoseconds = round(min(max(seconds, 0.0), _MAX_SECONDS) * NS_PER_S)
    duration.sec, duration.nanosec = divmod(nanoseconds, NS_PER_S)


def check_frame(frame: str, expected: str, field: str = "frame_id") -> None:
    """Refuse a message in another frame than ``expected``."""
    if frame != expected:
        raise BadMessageError(f"wrong {field}", f"{frame[:80]!r}, not {expected!r}")


def check_numbers(numbers: Iterable[float], limit: float, what: str) -> None:
    """Refuse numbers that are not finite or larger than ``limit``; ``what`` names them in the error."""
    for number in numbers:
        if not -limit <= number <= limit:
            kind = f"{what} out of range" if math.isfinite(number) else f"{what} not finite"
            raise BadMessageError(kind, f"{number!r}")


def yaw_of(orientation: Any) -> float:
    """Yaw [rad] of an orientation; its squared length may differ from 1 by a tenth, for rounding by hand."""
    x, y, z, w = orientation.x, orientation.y, orientation.z, orientation.w
    square = x * x + y * y + z * z + w * w
    if not math.isfinite(square):
        raise BadMessageError("orientation not finite")
    if not 0.9 <= square <= 1.1:
        raise BadMessageError("orientation is no unit quaternion", f"squared length {square:g}")
    return yaw_of_quaternion(x, y, z, w)


def pose_of(message: Any) -> Pose:
    """Planar pose of a geometry_msgs/Pose."""
    x, y = message.position.x, message.position.y
    check_numbers((x, y), MAX_COORDINATE, "position")
    return Pose(x, y, yaw_of(message.orientation))


def planar_covariance(covariance: Any) -> Array:
    """(3, 3) covariance of x, y, yaw out of the 36 numbers of a pose covariance."""
    return check_covariance(planar_block(covariance))


def planar_block(covariance: Any) -> Array:
    """Return the same without a check."""
    block: Array = np.asarray(covariance, dtype=float)[_PLANAR].reshape(3, 3)
    return block


def twist_from(message: Any) -> Twist:
    """Return the planar part of a geometry_msgs/Twist."""
    v, omega = message.linear.x, message.angular.z
    check_numbers((v, omega), MAX_SPEED, "velocity")
    return Twist(v, omega)


def fill_pose(message: Any, pose: Pose) -> None:
    """Write ``pose`` into a geometry_msgs/Pose in place."""
    message.position.x = float(pose.x)
    message.position.y = float(pose.y)
    fill_yaw(message.orientation, pose.theta)


def pose_in_message(pose: Pose) -> Pose:
    """Return the pose that :func:`pose_of` reads from what :func:`fill_pose` writes: its yaw is a quaternion's."""
    z, w = quaternion_of_yaw(pose.theta)
    return Pose(pose.x, pose.y, yaw_of_quaternion(0.0, 0.0, z, w))


def fill_yaw(orientation: Any, yaw: float) -> None:
    """Write a rotation by ``yaw`` [rad] about z in place; x and y have to be 0 already."""
    orientation.z, orientation.w = quaternion_of_yaw(float(yaw))


def fill_planar_covariance(covariance: Any, P: Array) -> None:
    """Write a (3, 3) covariance of x, y, yaw into the 36 numbers of a message, whose other entries stay."""
    covariance[_PLANAR] = P.reshape(9)


def fill_twist(message: Any, twist: Twist) -> None:
    """Write ``twist`` into a message in place."""
    message.linear.x = float(twist.v)
    message.angular.z = float(twist.omega)


def fill_twist_covariance(covariance: Any, M: TwistCovariance) -> None:
    """Write ``M`` into the 36 numbers of a twist covariance."""
    covariance[0], covariance[35] = M.var_v, M.var_omega
    covariance[5] = covariance[30] = M.cov_v_omega


def fill_unestimated(pose_covariance: Any, twist_covariance: Any | None = None) -> None:
    """Write the constants of both covariances (36,): z, roll and pitch have a huge variance, no motion is sideways."""
    pose_covariance[[14, 21, 28]] = 1e6
    if twist_covariance is not None:
        twist_covariance[[14, 21, 28]] = 1e6
        twist_covariance[7] = 1e-9
