"""What the ekf needs of a sensor: its topic, and its messages as measurements. Free of ROS.

A message is anything with the fields of its type, from rclpy or decoded from a bag.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

from diffbot_control.filter.gyro import GyroSample
from diffbot_control.filter.localization import Localization
from diffbot_control.filter.measurements import Measurement
from diffbot_core.errors import BadMessageError


class Reading(NamedTuple):
    """What a message holds."""

    measurements: list[Measurement]
    uses_fallback: bool = False
    """the covariance is that of the parameters"""
    unknown: int = 0
    """number of landmarks and the like that the map does not have"""
    gyro: GyroSample | None = None
    """a turn rate"""


class Sensor(Protocol):
    """A source of measurements."""

    topic: str
    message_type: str
    """e.g. ``sensor_msgs/msg/Imu``"""

    def read(self, message: Any) -> Reading:
        """Return the measurements of a message.

        Raises:
            BadMessageError: for a message that cannot be used.
        """


def fuse(reading: Reading, localization: Localization, drop: Callable[[BadMessageError], None]) -> None:
    """Fuse the measurements of a message; of several, each bad one is dropped for itself.

    Raises:
        BadMessageError: if there is one measurement only, or a turn rate, and it cannot be used.
    """
    if reading.gyro is not None:
        localization.on_gyro(reading.gyro)
    errors = localization.on_measurements(reading.measurements)
    for error in errors:
        if len(reading.measurements) == 1:
            raise error
        drop(error)
