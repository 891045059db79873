"""Inputs and diagnostic values of the ekf, for the node and for bags; this module does not import ROS."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from diffbot_control.filter.consistency import nis_bounds
from diffbot_control.filter.covariance import UnknownCovarianceError, check_covariance
from diffbot_control.filter.ekf import REJECTED, RELOCATED, WEIGHED
from diffbot_control.filter.localization import Localization
from diffbot_control.filter.measurement import FIXES
from diffbot_control.filter.models import Array
from diffbot_control.filter.odometry import OdometryStep
from diffbot_control.ros.messages.fields import MAX_SPEED, check_frame, check_numbers, measured_ns, twist_from
from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_control.ros.sensors import global_pose_noise, sensors_of, stamped_pose
from diffbot_control.ros.transforms import NO_TRANSFORMS, Transforms
from diffbot_core.errors import BadMessageError
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import TwistCovariance, WheelSpeeds, body_twist, encoder_covariance
from diffbot_core.shared_parameters import robot_frame

WHEEL_NOISE = 0.05
"""Bound of the relative error of each wheel speed; the errors of two messages are independent. The parameter
``odometry_covariance_scale`` scales the resulting covariance."""
_ERRORS = (
    "left wheel radius error",
    "right wheel radius error",
    "wheel separation error",
    "gyro bias",
    "landmark range offset error",
    "landmark range scale error",
    "landmark bearing offset error",
)
"""Names of the errors in the order of the states."""


class EkfInputs:
    """Converts the inputs of the ekf to values.

    Every method raises BadMessageError for a message that cannot be used.
    """

    def __init__(self, config: EkfNodeConfig, transforms: Transforms = NO_TRANSFORMS) -> None:
        """Store the configuration, and the transforms from the frames of the sensors to the frame of the robot."""
        self._config = config
        self._robot_frame = robot_frame(config)
        self.sensors = {sensor.topic: sensor for sensor in sensors_of(config, transforms)}
        """sensors by topic, in the order in which their waiting messages are handled"""
        # The user chooses the covariance of initialpose, so override_covariance does not apply to it.
        self.initial_noise = global_pose_noise(config)._replace(always=False)

    def initialpose(self, message: Any) -> tuple[int, Pose, Array]:
        """Return stamp [ns], pose and covariance (3, 3) of a message on ``initialpose``."""
        return stamped_pose(message, self._config.map_frame, self.initial_noise)

    def odometry(self, message: Any) -> OdometryStep:
        """Return the step of an Odometry. An unknown covariance is set to zero, see :class:`OdometryConfig`."""
        check_frame(message.child_frame_id, self._robot_frame, "child_frame_id", "base_link_frame (and frame_prefix)")
        twist, covariance = twist_from(message.twist.twist), message.twist.covariance
        var_v, cov, var_omega = float(covariance[0]), float(covariance[5]), float(covariance[35])
        try:
            check_covariance(np.array(((var_v, cov), (cov, var_omega))))
        except UnknownCovarianceError:
            var_v = cov = var_omega = 0.0
        return OdometryStep(measured_ns(message.header.stamp), twist, TwistCovariance(var_v, cov, var_omega))

    def joint_states(self, message: Any) -> OdometryStep | None:
        """Return the step of a JointState; None if it contains only other joints, e.g. of an arm."""
        wheels, left, right = self._config.wheels, self._config.left_wheel_name, self._config.right_wheel_name
        names, velocity = message.name, message.velocity
        if left not in names and right not in names:
            return None
        try:
            speeds = WheelSpeeds(velocity[names.index(left)], velocity[names.index(right)])
        except (ValueError, IndexError):
            remedy = "the driver has to publish the velocities of both wheels, or set odometry_source to odom"
            raise BadMessageError("wheel joints missing", f"no velocity of {left!r} and {right!r}: {remedy}") from None
        check_numbers(speeds, MAX_SPEED, "wheel speed")
        stamp = measured_ns(message.header.stamp)
        return OdometryStep(stamp, body_twist(speeds, wheels), encoder_covariance(speeds, WHEEL_NOISE, wheels))


def localization_values(localization: Localization) -> dict[str, str]:
    """Return key-value pairs for a diagnostic status: consistency, counts, estimated errors with their deviations."""
    values, consistency = {}, localization.consistency()
    if consistency:
        numbers = sum(one.numbers for one in consistency.values())
        mean = sum(one.nis * one.numbers for one in consistency.values()) / numbers
        values["NIS per number"] = f"{mean:.3f}"
        values["NIS 95 % bounds"] = "{:.3f} {:.3f}".format(*nis_bounds(numbers))
    for name, one in consistency.items():
        values[f"NIS per number of {name}"] = f"{one.nis:.3f}"
        if one.autocorrelation is not None:
            values[f"autocorrelation of {name}"] = f"{one.autocorrelation:.3f}"
            values[f"autocorrelation of {name}, 95 % bound"] = f"{one.bound:.3f}"
        if localization.options.finds_noise or localization.options.fuzzy:
            values[f"correlation of neighbouring {name} assumed"] = f"{one.assumed:.2f}"
            values[f"variances of {name} over claimed ones"] = "{:.2f} {:.2f}".format(*one.scale)
    for name, counts in localization.outcomes.items():
        if counts[WEIGHED]:
            values[f"{name} weighed"] = str(counts[WEIGHED])
        if counts[REJECTED] or counts[RELOCATED] or name == FIXES:
            values[f"{name} rejected"] = str(counts[REJECTED])
            values[f"relocations by {name}"] = str(counts[RELOCATED])
    x, P = localization.filter.x, localization.filter.P
    for at, (name, variance) in enumerate(zip(_ERRORS, localization.options.variances, strict=True), 3):
        if variance > 0.0:
            values[name] = f"{x[at]:+.4f} +- {math.sqrt(max(P[at, at], 0.0)):.4f}"
    return values
