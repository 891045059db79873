"""Sensors of the ekf: messages to measurements. A new one is a module here and a line in :func:`sensors_of`."""

from __future__ import annotations

from diffbot_control.ros.parameters.dock import NO_DOCK
from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_control.ros.sensors.dock import DockSensor
from diffbot_control.ros.sensors.fixes import fix_sensors
from diffbot_control.ros.sensors.gyro import Gyro
from diffbot_control.ros.sensors.heading import Compass
from diffbot_control.ros.sensors.landmarks import LandmarkSensor
from diffbot_control.ros.sensors.sensor import Sensor


def sensors_of(config: EkfNodeConfig) -> list[Sensor]:
    """Return the sensors that a configuration describes, in the order in which their waiting messages are handled."""
    sensors: list[Sensor] = [*fix_sensors(config), Compass(config)]
    if config.landmarks.landmark_ids:
        sensors.append(LandmarkSensor(config))
    if config.localization.filter.use_gyro:
        sensors.append(Gyro(config))
    if config.dock.dock_detection != NO_DOCK:
        sensors.append(DockSensor(config))
    return sensors
