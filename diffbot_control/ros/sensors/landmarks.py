"""Landmarks: range and bearing of known points in a PointCloud2 on ``landmarks``."""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import numpy as np

from diffbot_control.filter.covariance import check_covariance
from diffbot_control.filter.measurements import Array, LandmarkMeasurement
from diffbot_control.ros.frames import robot_frame
from diffbot_control.ros.messages.fields import check_frame, stamp_ns
from diffbot_control.ros.messages.landmark_cloud import LandmarkPoint, landmark_points
from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_control.ros.sensors.noise import KnownNoise, diagonal, noise_of
from diffbot_control.ros.sensors.sensor import Reading
from diffbot_core.errors import BadMessageError
from diffbot_core.geometry import Point


class LandmarkSensor:
    """The source of landmark measurements."""

    topic, message_type = "landmarks", "sensor_msgs/msg/PointCloud2"

    def __init__(self, config: EkfNodeConfig) -> None:
        """Take the map and the fallback variances."""
        noise = config.noise
        sigmas = noise.landmark_range_sigma, noise.landmark_bearing_sigma
        self._noise = KnownNoise(diagonal(sigmas), noise.override_covariance)
        self._sigma_per_metre = noise.landmark_range_sigma_per_metre
        self._frame, self._points = robot_frame(config), config.landmarks.points()

    def read(self, message: Any) -> Reading:
        """Return the measurements of the known landmarks in a message."""
        found, unknown = landmarks_from(message, self._frame, self._points, self._noise, self._sigma_per_metre)
        return Reading([*found], unknown=unknown)


def landmarks_from(
    message: Any, frame: str, points: dict[int, Point], noise: KnownNoise, sigma_per_metre: float = 0.0
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
        R = _landmark_noise(one, _at_range(noise, sigma_per_metre, one.range))
        measurements.append(LandmarkMeasurement(stamp, one.range, one.bearing, R, points[one.number]))
    return measurements, unknown


def _at_range(noise: KnownNoise, sigma_per_metre: float, distance: float) -> KnownNoise:
    """Return the noise of a landmark at a ``distance`` [m], by which the deviation of the range grows."""
    if noise.R is None or sigma_per_metre == 0.0:
        return noise
    sigma = math.sqrt(noise.R[0, 0]) + sigma_per_metre * distance
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
