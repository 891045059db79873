"""The gyro: the turn rate of an Imu on ``imu``."""

from __future__ import annotations

from typing import Any

import numpy as np

from diffbot_control.filter.covariance import check_covariance
from diffbot_control.filter.gyro import GyroSample
from diffbot_control.ros.messages.fields import MAX_SPEED, check_numbers, stamp_ns
from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_control.ros.sensors.noise import KnownNoise, diagonal, noise_of
from diffbot_control.ros.sensors.sensor import Reading
from diffbot_core.errors import BadMessageError


class Gyro:
    """The source of turn rates. The frame of its messages is not used: the z axis of the sensor has to point up."""

    topic, message_type = "imu", "sensor_msgs/msg/Imu"

    def __init__(self, config: EkfNodeConfig) -> None:
        """Take the fallback variance."""
        self._noise = KnownNoise(diagonal((config.noise.gyro_sigma,)), config.noise.override_covariance)

    def read(self, message: Any) -> Reading:
        """Return the turn rate of a message; REP-145: covariance[0] = -1 means no angular velocity."""
        if message.angular_velocity_covariance[0] == -1.0:
            raise BadMessageError("no angular velocity in it")
        rate = float(message.angular_velocity.z)
        check_numbers((rate,), MAX_SPEED, "turn rate")
        variance = float(message.angular_velocity_covariance[8])
        R = noise_of(lambda: check_covariance(np.array([[variance]])), self._noise)
        sample = GyroSample(stamp_ns(message.header.stamp), rate, R.item(0))
        return Reading([], R is self._noise.R, gyro=sample)
