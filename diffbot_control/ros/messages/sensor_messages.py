"""Messages of sensors to measurements of the filter; a bad message raises BadMessageError.

Free of ROS: a message is anything with the fields of its type, from rclpy or decoded from a bag.

An all-zero covariance in a message means *unknown*, never *exact*: the fallback is used, and without one the message is
dropped.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from diffbot_control.filter.covariance import UnknownCovarianceError, check_covariance, check_rows
from diffbot_control.filter.measurements import Array, Heading, LandmarkMeasurement, OdometryStep, PoseFix
from diffbot_control.ros.messages.landmark_cloud import LandmarkPoint, landmark_points
from diffbot_control.ros.messages.message_fields import (
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
from diffbot_core.geometry import Point
from diffbot_core.kinematics import TwistCovariance, WheelSpeeds


class KnownNoise(NamedTuple):
    """Configured noise of a sensor, beside the covariances in its messages."""

    R: Array | None = None
    """fallback covariance; None if there is none"""
    always: bool = False
    """use R even if a message has a covariance"""
    range_sigma_per_metre: float = 0.0
    """of landmarks: by what the standard deviation of R[0, 0] grows with the range [m/m]"""


MESSAGE_NOISE = KnownNoise()
"""The messages' covariances are used, and a message without one is dropped."""


def fix_from(message: Any, frame: str, noise: KnownNoise = MESSAGE_NOISE) -> PoseFix:
    """Return the pose fix of a PoseWithCovarianceStamped in ``frame``; for its covariance see :func:`noise_of`."""
    check_frame(message.header.frame_id, frame)
    pose = pose_of(message.pose.pose)
    R = noise_of(lambda: planar_covariance(message.pose.covariance), noise)
    return PoseFix(stamp_ns(message.header.stamp), pose, R)


def heading_from(message: Any, frame: str, noise: KnownNoise = MESSAGE_NOISE) -> Heading:
    """Return the compass heading of an Imu fixed to ``frame``; REP-145: covariance[0] = -1 means no orientation."""
    check_frame(message.header.frame_id, frame)
    if message.orientation_covariance[0] == -1.0:
        raise BadMessageError("no orientation in it")
    yaw = yaw_of(message.orientation)
    R = noise_of(lambda: check_covariance(np.array([[float(message.orientation_covariance[8])]])), noise)
    return Heading(stamp_ns(message.header.stamp), yaw, R)


def landmarks_from(
    message: Any, frame: str, points: dict[int, Point], noise: KnownNoise
) -> tuple[list[LandmarkMeasurement], int]:
    """Return the measurements of known landmarks in a cloud in ``frame``, and how many of its landmarks are unknown.

    ``points``: position [m] of each known landmark by its number; for the covariances see :func:`noise_of`.
    """
    check_frame(message.header.frame_id, frame)
    stamp, measurements, unknown = stamp_ns(message.header.stamp), [], 0
    for one in landmark_points(message):
        if one.number not in points:
            unknown += 1
            continue
        R = _landmark_noise(one, _at_range(noise, one.range))
        measurements.append(LandmarkMeasurement(stamp, one.range, one.bearing, R, points[one.number]))
    return measurements, unknown


def _at_range(noise: KnownNoise, distance: float) -> KnownNoise:
    """Return the noise of a landmark at a ``distance`` [m]."""
    if noise.R is None or noise.range_sigma_per_metre == 0.0:
        return noise
    sigma = math.sqrt(noise.R[0, 0]) + noise.range_sigma_per_metre * distance
    return KnownNoise(np.diag((sigma * sigma, noise.R[1, 1])), noise.always)


def _landmark_noise(point: LandmarkPoint, noise: KnownNoise) -> Array:
    """Return R (2, 2); the variance of a missing number is inf."""
    variances = point.var_range, point.var_bearing
    measured = [index for index in (0, 1) if math.isfinite(variances[index])]
    if len(measured) == 2:
        return noise_of(partial(_landmark_covariance, point), noise)
    if not measured:
        raise BadMessageError("no finite variance", f"of landmark {point.number}")
    one = measured[0]
    fallback = None if noise.R is None else noise.R[one : one + 1, one : one + 1]
    R = np.diag((math.inf, math.inf))
    R[one, one] = noise_of(lambda: check_covariance(np.array([[variances[one]]])), KnownNoise(fallback, noise.always))[
        0, 0
    ]
    return R


def _landmark_covariance(point: LandmarkPoint) -> Array:
    return check_covariance(np.diag((point.var_range, point.var_bearing)))


def noise_of(read: Callable[[], Array], noise: KnownNoise) -> Array:
    """Return the covariance that ``read`` gets from a message, or the fallback.

    The fallback is used if it overrides the message, or if the message's covariance is unknown: all zero, singular or
    absurdly large.

    Raises:
        BadMessageError: if the covariance is wrong (not finite, not symmetric, indefinite), which is the sign of a
            broken sender, or unknown and there is no fallback.
    """
    if noise.R is not None and noise.always:
        return noise.R
    try:
        return read()
    except UnknownCovarianceError:
        if noise.R is None:
            raise
        return noise.R


def odometry_from(message: Any, child_frame: str) -> OdometryStep:
    """Return stamp, twist in ``child_frame`` and its covariance; all zero if unknown: the caller has the fallback."""
    check_frame(message.child_frame_id, child_frame, "child_frame_id")
    measured = message.twist
    twist, covariance = twist_from(measured.twist), measured.covariance
    var_v, cov, var_omega = float(covariance[0]), float(covariance[5]), float(covariance[35])
    if any((var_v, cov, var_omega)):
        check_rows([[var_v, cov], [cov, var_omega]])
    return OdometryStep(stamp_ns(message.header.stamp), twist, TwistCovariance(var_v, cov, var_omega))


def wheel_speeds_from(message: Any, left: str, right: str) -> tuple[int, WheelSpeeds]:
    """Stamp [ns] and speeds of the two wheels of these joint names."""
    try:
        speeds = WheelSpeeds(message.velocity[message.name.index(left)], message.velocity[message.name.index(right)])
    except (ValueError, IndexError):
        raise BadMessageError("wheel joints missing", f"no velocity of {left!r} and {right!r}") from None
    check_numbers(speeds, MAX_SPEED, "wheel speed")
    return stamp_ns(message.header.stamp), speeds
