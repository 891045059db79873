"""Messages of sensors to measurements of the filter; a bad message raises BadMessageError."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Imu, JointState, PointCloud2

from diffbot_control.filter.covariance import check_covariance
from diffbot_control.filter.measurements import Array, Measurement
from diffbot_control.ros.landmark_cloud import LandmarkPoint, landmark_points
from diffbot_control.ros.messages import (
    MAX_SPEED,
    check_frame,
    check_numbers,
    planar_covariance,
    pose_of,
    stamp_ns,
    twist_from,
    yaw_of,
)
from diffbot_core.errors import BadMessageError
from diffbot_core.kinematics import Twist, WheelSpeeds


class KnownNoise(NamedTuple):
    """What is known of a sensor's noise beside its messages."""

    R: Array | None = None
    """covariance, the fallback; None if there is none"""
    always: bool = False
    """do not look at the messages'"""


MESSAGE_NOISE = KnownNoise()
"""Nothing: the messages' covariances count, and a message without one is dropped."""


def fix_from(message: PoseWithCovarianceStamped, frame: str, noise: KnownNoise = MESSAGE_NOISE) -> Measurement:
    """Return a pose fix in ``frame``; for its covariance see :func:`noise_of`."""
    check_frame(message.header.frame_id, frame)
    pose = pose_of(message.pose.pose)
    R = noise_of(lambda: planar_covariance(message.pose.covariance), noise)
    return Measurement(stamp_ns(message.header.stamp), np.array(pose), R)


def heading_from(message: Imu, frame: str, noise: KnownNoise = MESSAGE_NOISE) -> Measurement:
    """Return a compass heading of a sensor fixed to ``frame``; REP-145: covariance[0] = -1 means no orientation."""
    check_frame(message.header.frame_id, frame)
    if message.orientation_covariance[0] == -1.0:
        raise BadMessageError("no orientation in it")
    yaw = yaw_of(message.orientation)
    R = noise_of(lambda: check_covariance(np.array([[float(message.orientation_covariance[8])]])), noise)
    return Measurement(stamp_ns(message.header.stamp), np.array([yaw]), R)


def landmarks_from(
    message: PointCloud2, frame: str, points: dict[int, tuple[float, float]], noise: KnownNoise
) -> tuple[list[Measurement], int]:
    """Return range and bearing of each known landmark in a cloud in ``frame``, and how many are not known.

    ``points``: x, y [m] of each by its number; the covariance is the message's where it has both variances.
    """
    check_frame(message.header.frame_id, frame)
    stamp, measurements, unknown = stamp_ns(message.header.stamp), [], 0
    for seen in landmark_points(message):
        if seen.number not in points:
            unknown += 1
            continue
        R = noise_of(partial(_landmark_covariance, seen), noise)
        measurements.append(Measurement(stamp, np.array((seen.distance, seen.bearing)), R, points[seen.number]))
    return measurements, unknown


def _landmark_covariance(seen: LandmarkPoint) -> Array:
    return check_covariance(np.diag((seen.var_distance, seen.var_bearing)))


def noise_of(read: Callable[[], Array], noise: KnownNoise) -> Array:
    """Return the covariance that ``read`` finds in a message, or the fallback.

    The fallback is taken where it is given and the message's is not usable or not wanted.

    Raises:
        BadMessageError: if the message's is not usable and there is no fallback.
    """
    if noise.R is not None and noise.always:
        return noise.R
    try:
        return read()
    except BadMessageError:
        if noise.R is None:
            raise
        return noise.R


def odometry_from(message: Odometry, child_frame: str) -> tuple[int, Twist, tuple[float, float, float]]:
    """Stamp [ns], twist in ``child_frame`` and its (var(v), cov(v, omega), var(omega)); all zero if not given."""
    check_frame(message.child_frame_id, child_frame, "child_frame_id")
    twist = twist_from(message.twist.twist)
    covariance = message.twist.covariance
    variances = float(covariance[0]), float(covariance[5]), float(covariance[35])
    if any(variances):
        check_covariance(np.array([variances[:2], variances[1:]]))
    return stamp_ns(message.header.stamp), twist, variances


def wheel_speeds_from(message: JointState, left: str, right: str) -> tuple[int, WheelSpeeds]:
    """Stamp [ns] and speeds of the two wheels of these joint names."""
    try:
        speeds = WheelSpeeds(message.velocity[message.name.index(left)], message.velocity[message.name.index(right)])
    except (ValueError, IndexError):
        raise BadMessageError("wheel joints missing", f"no velocity of {left!r} and {right!r}") from None
    check_numbers(speeds, MAX_SPEED, "wheel speed")
    return stamp_ns(message.header.stamp), speeds
