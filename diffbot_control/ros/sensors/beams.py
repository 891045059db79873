"""Beams: the distance to walls of the map as sensor_msgs/Range."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from diffbot_control.filter.covariance import check_covariance
from diffbot_control.filter.measurements.wall import WallRange
from diffbot_control.filter.wall_map import Wall
from diffbot_control.ros.messages.fields import stamp_ns
from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_control.ros.sensors.noise import KnownNoise, diagonal, noise_of
from diffbot_control.ros.sensors.sensor import Reading
from diffbot_core.errors import BadMessageError
from diffbot_core.geometry import Pose


class BeamSensor:
    """One beam, at a known place on the robot; the frame of its messages is not used."""

    message_type = "sensor_msgs/msg/Range"

    def __init__(self, topic: str, beam: Pose, walls: tuple[Wall, ...], noise: KnownNoise) -> None:
        """Describe the beam: its topic, its origin and direction on the robot, the map, the fallback variance."""
        self.topic, self._beam, self._walls, self._noise = topic, beam, walls, noise

    def read(self, message: Any) -> Reading:
        """Return the range of a message; none without an echo (REP 117: infinite, or outside of the sensor's range)."""
        distance = float(message.range)
        if math.isnan(distance):
            raise BadMessageError("range is nan")
        if not message.min_range <= distance <= message.max_range:
            return Reading([])
        R = noise_of(lambda: check_covariance(np.array([[float(message.variance)]])), self._noise)
        measured = WallRange(stamp_ns(message.header.stamp), distance, R, self._beam, self._walls)
        return Reading([measured], R is self._noise.R)


def beam_sensors(config: EkfNodeConfig) -> list[BeamSensor]:
    """Return the beams of a configuration; none without walls."""
    walls = config.beams.map.walls()
    noise = KnownNoise(diagonal((config.beams.beam_sigma,)), config.noise.override_covariance)
    beams = config.beams.map.beams() if walls else {}
    return [BeamSensor(topic, beam, walls, noise) for topic, beam in beams.items()]
