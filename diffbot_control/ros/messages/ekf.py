"""What the ekf reads from messages and writes into them, for the node and for recorded bags; free of ROS."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from diffbot_control.filter.gated_filter import GatedFilter
from diffbot_control.filter.measurements import PoseFix
from diffbot_control.filter.odometry import OdometryStep
from diffbot_control.ros.frames import robot_frame
from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_control.ros.sensors import sensors_of
from diffbot_control.ros.sensors.fixes import fix_from, global_pose_noise
from diffbot_control.ros.sensors.odometry import odometry_from, wheel_speeds_from
from diffbot_control.ros.sensors.sensor import Sensor
from diffbot_core.kinematics import body_twist, encoder_covariance

_WHEEL_ERRORS = ("left wheel radius", "right wheel radius", "wheel separation")
_LANDMARK_ERRORS = ("landmark range offset", "landmark range scale", "landmark bearing offset")


class EkfInputs:
    """Conversion of each input of the ekf with the frames, the noise and the map of its configuration.

    Every method raises BadMessageError for a message that cannot be used.
    """

    def __init__(self, config: EkfNodeConfig) -> None:
        """Take the configuration."""
        self._config = config
        self._robot_frame = robot_frame(config)
        self.sensors = sensors_of(config)
        self._by_topic = {one.topic: one for one in self.sensors}
        # Its covariance was chosen by the user, so override_covariance does not apply; the fallback does.
        self.initial_noise = global_pose_noise(config)._replace(always=False)

    def sensor(self, topic: str) -> Sensor:
        """Return the sensor of a topic; the topics never change."""
        return self._by_topic[topic]

    def initialpose(self, message: Any) -> PoseFix:
        """Return the pose at which to put the filter."""
        return fix_from(message, self._config.map_frame, self.initial_noise)

    def odometry(self, message: Any) -> OdometryStep:
        """Return the step of an Odometry; an all-zero covariance means unknown, and the localization has its own."""
        return odometry_from(message, self._robot_frame)

    def joint_states(self, message: Any) -> OdometryStep:
        """Return the step of a JointState."""
        config = self._config
        stamp, speeds = wheel_speeds_from(message, config.left_wheel_name, config.right_wheel_name)
        covariance = encoder_covariance(speeds, config.wheel_noise, config.wheels)
        return OdometryStep(stamp, body_twist(speeds, config.wheels), covariance)


def error_values(ekf: GatedFilter) -> dict[str, str]:
    """Return key-value pairs: estimated errors with their deviations, and how long those of measurements last."""
    found = {}
    for names, estimate in ((_WHEEL_ERRORS, ekf.wheels()), (_LANDMARK_ERRORS, ekf.landmark_errors())):
        if estimate is not None:
            for name, error, variance in zip(names, estimate.errors, np.diagonal(estimate.P), strict=False):
                found[f"{name} error"] = f"{error:+.4f} +- {math.sqrt(max(variance, 0.0)):.4f}"
    bias = ekf.gyro_bias()
    if bias is not None:
        found["gyro bias"] = f"{bias.errors.item(0):+.4f} +- {math.sqrt(max(bias.P.item(0), 0.0)):.4f}"
    c = ekf.fix_correlation()
    if c is not None:
        found["correlation of neighbouring fixes found"] = f"{c:.2f}"
    time = ekf.landmark_correlation_time()
    if time is not None:
        found["correlation time of landmarks found"] = f"{time:.2f}"
    return found
