"""Conversion of fields of messages to values and back; fields that cannot be used raise BadMessageError.

This module does not import ROS: a message is any object with the fields of its type, from rclpy or from a bag.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from diffbot_control.filter.covariance import check_covariance, uncertainty_of
from diffbot_control.filter.models import Array
from diffbot_core.errors import BadMessageError
from diffbot_core.geometry import MAX_COORDINATE, Pose, quaternion_of_yaw, yaw_of_quaternion
from diffbot_core.kinematics import Twist, TwistCovariance
from diffbot_core.stamps import NS_PER_S
from diffbot_core.uncertainty import Uncertainty

MAX_SPEED = 1e4
"""[m/s], [rad/s] largest valid speed"""

_MAX_SECONDS = 2.0**31 - 1.0

# Indices of (x, y, yaw) in the row-major 6 x 6 covariance of REP-103's (x, y, z, roll, pitch, yaw).
_PLANAR = np.array([0, 1, 5, 6, 7, 11, 30, 31, 35])


def stamp_ns(stamp: Any) -> int:
    """Return a stamp in nanoseconds."""
    if stamp.nanosec >= NS_PER_S:
        raise BadMessageError("stamp not normalised", f"nanosec is {stamp.nanosec}, but must be below 1000000000")
    return int(stamp.sec) * NS_PER_S + int(stamp.nanosec)


def measured_ns(stamp: Any) -> int:
    """Return the stamp of a measurement in nanoseconds. A stamp of zero is an error, since the time is unknown."""
    nanoseconds = stamp_ns(stamp)
    if nanoseconds == 0:
        raise BadMessageError("stamp is zero", "the driver has to fill header.stamp with the time of the measurement")
    return nanoseconds


def set_stamp(stamp: Any, nanoseconds: int) -> None:
    """Write nanoseconds into a stamp in place."""
    stamp.sec, stamp.nanosec = divmod(nanoseconds, NS_PER_S)


def fill_duration(duration: Any, seconds: float) -> None:
    """Write a duration [s] into a Duration in place, clipped to the range of the message."""
    nanoseconds = round(min(max(seconds, 0.0), _MAX_SECONDS) * NS_PER_S)
    duration.sec, duration.nanosec = divmod(nanoseconds, NS_PER_S)


def check_frame(frame: str, expected: str, field: str = "frame_id", parameter: str = "") -> None:
    """Refuse a frame other than ``expected``.

    Args:
        frame: frame of the message.
        expected: required frame.
        field: name of the field for the error text.
        parameter: name of the parameter that sets ``expected``, for the error text.
    """
    if frame != expected:
        remedy = f": set {parameter} of all nodes to it, or correct the driver" if parameter and frame else ""
        raise BadMessageError(f"wrong {field}", f"{frame[:80]!r}, not {expected!r}{remedy}")


def check_numbers(numbers: Iterable[float], limit: float, what: str) -> None:
    """Refuse numbers that are not finite or exceed ``limit`` in size; ``what`` names them in the error text."""
    for number in numbers:
        if not -limit <= number <= limit:
            kind = f"{what} out of range" if math.isfinite(number) else f"{what} not finite"
            raise BadMessageError(kind, f"{number!r}")


def yaw_of(orientation: Any) -> float:
    """Return the yaw [rad] of an orientation."""
    x, y, z, w = orientation.x, orientation.y, orientation.z, orientation.w
    square = x * x + y * y + z * z + w * w
    if not math.isfinite(square):
        raise BadMessageError("orientation not finite")
    # Quaternions that users type by hand are rounded.
    if not 0.9 <= square <= 1.1:
        raise BadMessageError("orientation is not a unit quaternion", f"squared length {square:g}")
    return yaw_of_quaternion(x, y, z, w)


def pose_of(message: Any) -> Pose:
    """Return the planar pose of a geometry_msgs/Pose."""
    x, y = message.position.x, message.position.y
    check_numbers((x, y), MAX_COORDINATE, "position")
    return Pose(x, y, yaw_of(message.orientation))


def planar_covariance(covariance: Any) -> Array:
    """Return the checked (3, 3) covariance of x, y, yaw from the 36 numbers of a pose covariance."""
    return check_covariance(planar_block(covariance))


def planar_block(covariance: Any) -> Array:
    """Return the unchecked (3, 3) covariance of x, y, yaw from the 36 numbers of a pose covariance."""
    block: Array = np.asarray(covariance, dtype=float)[_PLANAR].reshape(3, 3)
    return block


def pose_from(message: Any, frame: str, child_frame: str) -> tuple[int, Pose, Uncertainty | None]:
    """Return stamp [ns], pose and uncertainty of an estimate; the uncertainty is None if the covariance is all zero.

    Args:
        message: PoseWithCovarianceStamped or Odometry.
        frame: required frame.
        child_frame: required child frame of an Odometry.

    Raises:
        BadMessageError: if a frame differs, or the stamp, the pose or its planar covariance cannot be used.
    """
    check_frame(message.header.frame_id, frame)
    if hasattr(message, "child_frame_id"):
        check_frame(message.child_frame_id, child_frame, "child_frame_id")
    pose = pose_of(message.pose.pose)
    covariance = planar_block(message.pose.covariance)
    uncertainty = uncertainty_of(check_covariance(covariance)) if covariance.any() else None
    return measured_ns(message.header.stamp), pose, uncertainty


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
    """Return ``pose`` as a subscriber reads it from a message: the conversion to a quaternion rounds the yaw."""
    z, w = quaternion_of_yaw(pose.theta)
    return Pose(pose.x, pose.y, yaw_of_quaternion(0.0, 0.0, z, w))


def fill_yaw(orientation: Any, yaw: float) -> None:
    """Write a rotation by ``yaw`` [rad] about z in place; x and y must already be 0."""
    orientation.z, orientation.w = quaternion_of_yaw(float(yaw))


def fill_planar_covariance(covariance: Any, P: Array) -> None:
    """Write a (3, 3) covariance of x, y, yaw into the 36 numbers of a message; the other numbers do not change."""
    covariance[_PLANAR] = P.reshape(9)


def fill_twist(message: Any, twist: Twist) -> None:
    """Write ``twist`` into a geometry_msgs/Twist in place."""
    message.linear.x = float(twist.v)
    message.angular.z = float(twist.omega)


def fill_twist_covariance(covariance: Any, M: TwistCovariance) -> None:
    """Write ``M`` into the 36 numbers of a twist covariance."""
    covariance[0], covariance[35] = M.var_v, M.var_omega
    covariance[5] = covariance[30] = M.cov_v_omega


def fill_unestimated(pose_covariance: Any, twist_covariance: Any | None = None) -> None:
    """Write the variances that are not estimated into covariances (36,): z, roll and pitch are unknown, and vy is 0."""
    pose_covariance[[14, 21, 28]] = 1e6
    if twist_covariance is not None:
        twist_covariance[[14, 21, 28]] = 1e6
        twist_covariance[7] = 1e-9
