"""What the ekf reads from messages and writes into them, for the node and for recorded bags; free of ROS."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from diffbot_control.filter.gated_filter import GatedFilter
from diffbot_control.filter.measurements import Array, Heading, LandmarkMeasurement, OdometryStep, PoseFix
from diffbot_control.filter.models import RadiusErrors, with_radius_errors, with_separation_error
from diffbot_control.ros.frames import robot_frame
from diffbot_control.ros.messages.sensor_messages import (
    KnownNoise,
    fix_from,
    heading_from,
    landmarks_from,
    odometry_from,
    wheel_speeds_from,
)
from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_core.kinematics import Twist, body_twist, encoder_covariance
from diffbot_core.units import S_PER_NS

_WHEEL_ERRORS = ("left wheel radius", "right wheel radius", "wheel separation")
_LANDMARK_ERRORS = ("landmark range offset", "landmark range scale", "landmark bearing offset")


class EkfInputs:
    """Conversion of each input of the ekf with the frames, the noise and the map of its configuration.

    Every method raises BadMessageError for a message that cannot be used.
    """

    def __init__(self, config: EkfNodeConfig) -> None:
        """Derive the fallback covariances from the configuration."""
        noise = config.noise
        always = noise.override_covariance
        xy, yaw = noise.global_pose_sigma_xy, noise.global_pose_sigma_yaw
        self._config = config
        self._robot_frame = robot_frame(config)
        self.landmark_points = config.landmarks.points()
        self.fix_noise = KnownNoise(_diagonal((xy, xy, yaw)), always)
        self._sources = config.localization.sources.settings()
        self.source_noises = [
            KnownNoise(_diagonal((one.sigma_xy, one.sigma_xy, one.sigma_yaw)), always) for one in self._sources
        ]
        """of the further sources of fixes"""
        self.heading_noise = KnownNoise(_diagonal((noise.heading_sigma,)), always)
        landmark = _diagonal((noise.landmark_range_sigma, noise.landmark_bearing_sigma))
        self._landmark_noise = KnownNoise(landmark, always, noise.landmark_range_sigma_per_metre)

    def fix(self, message: Any) -> PoseFix:
        """Return the fix of a PoseWithCovarianceStamped."""
        return fix_from(message, self._config.map_frame, self.fix_noise)

    def source_fix(self, index: int, message: Any) -> PoseFix:
        """Return the fix of the further source ``index``, stamped when it was measured."""
        fix = fix_from(message, self._config.map_frame, self.source_noises[index])
        return fix._replace(stamp=fix.stamp - round(self._sources[index].delay / S_PER_NS), source=index + 1)

    def initialpose(self, message: Any) -> PoseFix:
        """Return the pose at which to put the filter.

        Its covariance was chosen by the user, so override_covariance does not apply; the fallback does.
        """
        return fix_from(message, self._config.map_frame, self.fix_noise._replace(always=False))

    def heading(self, message: Any) -> Heading:
        """Return the heading of an Imu."""
        return heading_from(message, self._robot_frame, self.heading_noise)

    def landmarks(self, message: Any) -> tuple[list[LandmarkMeasurement], int]:
        """Return the measurements of known landmarks in a PointCloud2, and how many of its landmarks are unknown."""
        return landmarks_from(message, self._robot_frame, self.landmark_points, self._landmark_noise)

    def odometry(self, message: Any) -> OdometryStep:
        """Return the step of an Odometry; an all-zero covariance means unknown, and the localization has its own."""
        return odometry_from(message, self._robot_frame)

    def joint_states(self, message: Any) -> OdometryStep:
        """Return the step of a JointState."""
        config = self._config
        stamp, speeds = wheel_speeds_from(message, config.left_wheel_name, config.right_wheel_name)
        covariance = encoder_covariance(speeds, config.wheel_noise, config.wheels)
        return OdometryStep(stamp, body_twist(speeds, config.wheels), covariance)


def corrected_twist(measured: Twist, ekf: GatedFilter, wheel_separation: float) -> Twist:
    """Return the twist corrected by the estimated wheel errors, if there are any; ``wheel_separation`` is L [m]."""
    wheels = ekf.wheels()
    if wheels is None:
        return measured
    left, right, *separation = wheels.errors.tolist()
    twist = with_radius_errors(measured, RadiusErrors(left, right), wheel_separation)
    return with_separation_error(twist, separation[0]) if separation else twist


def error_values(ekf: GatedFilter) -> dict[str, str]:
    """Return key-value pairs of the estimated errors with their standard deviations, and of what fixes correlate by."""
    found = {}
    for names, estimate in ((_WHEEL_ERRORS, ekf.wheels()), (_LANDMARK_ERRORS, ekf.landmark_errors())):
        if estimate is not None:
            for name, error, variance in zip(names, estimate.errors, np.diagonal(estimate.P), strict=False):
                found[f"{name} error"] = f"{error:+.4f} +- {math.sqrt(max(variance, 0.0)):.4f}"
    c = ekf.fix_correlation()
    if c is not None:
        found["correlation of neighbouring fixes found"] = f"{c:.2f}"
    return found


def _diagonal(sigmas: Sequence[float]) -> Array | None:
    """Return the covariance of independent errors; None if a standard deviation is 0: unknown."""
    return np.diag(np.square(sigmas)) if all(sigmas) else None
