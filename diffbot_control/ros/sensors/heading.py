"""Headings: the orientation of an Imu on ``heading``."""

from __future__ import annotations

from typing import Any

import numpy as np

from diffbot_control.filter.covariance import check_covariance
from diffbot_control.filter.measurements import Heading
from diffbot_control.ros.frames import robot_frame
from diffbot_control.ros.messages.fields import check_frame, stamp_ns, yaw_of
from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_control.ros.sensors.noise import MESSAGE_NOISE, KnownNoise, diagonal, noise_of
from diffbot_control.ros.sensors.sensor import Reading
from diffbot_core.errors import BadMessageError


class Compass:
    """The source of headings."""

    topic, message_type = "heading", "sensor_msgs/msg/Imu"

    def __init__(self, config: EkfNodeConfig) -> None:
        """Take the fallback variance and the frame of the robot."""
        self._noise = KnownNoise(diagonal((config.noise.heading_sigma,)), config.noise.override_covariance)
        self._frame = robot_frame(config)

    def read(self, message: Any) -> Reading:
        """Return the heading of a message."""
        heading = heading_from(message, self._frame, self._noise)
        return Reading([heading], heading.R is self._noise.R)


def heading_from(message: Any, frame: str, noise: KnownNoise = MESSAGE_NOISE) -> Heading:
    """Return the compass heading of an Imu fixed to ``frame``; REP-145: covariance[0] = -1 means no orientation."""
    check_frame(message.header.frame_id, frame)
    if message.orientation_covariance[0] == -1.0:
        raise BadMessageError("no orientation in it")
    yaw = yaw_of(message.orientation)
    R = noise_of(lambda: check_covariance(np.array([[float(message.orientation_covariance[8])]])), noise)
    return Heading(stamp_ns(message.header.stamp), yaw, R)
