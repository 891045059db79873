"""Define the quantities that a calibration estimates, and apply their values to the settings of a filter."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from diffbot_control.filter.models import LANDMARK, SENSOR, WHEELS, is_angle, is_fix, size_of
from diffbot_control.filter.odometry import MOTION, Densities
from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_tools.calibration.events import (
    FIX_SENSOR,
    FURTHER_SENSORS,
    HEADING_SENSOR,
    LANDMARK_SENSOR,
    RESET,
    Array,
    Events,
)
from diffbot_tools.calibration.kernel import MAX_DELAY, Settings

_DOWN, _SPREAD = 0.2, 3.0
"""Prior standard deviations of the logarithm of a noise or a time. If only landmarks are measured, _DOWN applies to
motion noise below the given noise: constant errors of the map make the odometry look better than it is."""
_MAX_LOG, _MAX_FACTOR_LOG = math.log(1e5), math.log(30.0)
CONSTANTS = {
    "left_radius_error": WHEELS,
    "right_radius_error": WHEELS + 1,
    "wheel_separation_error": WHEELS + 2,
    "landmark_range_offset": SENSOR,
    "landmark_range_scale": SENSOR + 1,
    "landmark_bearing_offset": SENSOR + 2,
}
"""Indices of the filter's constant states, by the names of their parameters."""
_WHEEL_SIGMA = 0.1
"""Prior standard deviation of the errors of the wheels in the search."""


class Quantity(NamedTuple):
    """A number to be estimated by the optimiser: a delay in seconds, or a factor by its logarithm."""

    name: str
    """name of a parameter or a factor"""
    field: str
    """field of :class:`kernel.Settings`, or of its densities"""
    place: tuple[int, ...]
    """index in the field; () if the field is a number"""
    logarithmic: bool
    start: float
    """start of the search: the given delay, or 0 for the logarithm of a factor"""
    lower: float
    upper: float
    down: float = _SPREAD
    """standard deviation of the prior of a logarithm, below the start"""

    @property
    def spread(self) -> float:
        """Return the standard deviation of the prior."""
        return _SPREAD if self.logarithmic else MAX_DELAY / math.sqrt(12.0)

    def penalty(self, value: float) -> float:
        """Return the negative logarithm of the prior at ``value``, up to a constant."""
        away = value - self.start
        return 0.5 * (away / (self.down if away < 0.0 else _SPREAD)) ** 2 if self.logarithmic else 0.0


def quantities_of(drives: list[Events], config: EkfNodeConfig) -> list[Quantity]:
    """Return the quantities to estimate: delay of the odometry, noise of the motion, noise of each measured sensor."""
    kinds = {int(kind) for one in drives for kind in np.unique(one.measurements.kind)}
    down = _DOWN if max(kinds) >= LANDMARK and not any(map(is_fix, kinds)) else _SPREAD
    delay = min(config.localization.odometry.odometry_delay, MAX_DELAY)
    found = [Quantity("odometry_delay", "delay", (), False, delay, 0.0, MAX_DELAY)]
    for name in _motion_names(drives, config):
        found.append(Quantity(name, name, (), True, 0.0, -_MAX_LOG, _MAX_LOG, down))
    factors = [(name, "factors", index) for name, index in factors_of(config).items() if measures(drives, *index)]
    if any(len(one.rates.time) > 1 for one in drives):
        factors.append(("gyro_factor", "gyro_factor", ()))
    return found + [Quantity(*one, True, 0.0, -_MAX_FACTOR_LOG, _MAX_FACTOR_LOG) for one in factors]


def factors_of(config: EkfNodeConfig) -> dict[str, tuple[int, ...]]:
    """Return the index of each factor: the sensor, and 0 for positions and ranges or 1 for angles."""
    found: dict[str, tuple[int, ...]] = {
        "heading_factor": (HEADING_SENSOR, 1),
        "range_factor": (LANDMARK_SENSOR, 0),
        "bearing_factor": (LANDMARK_SENSOR, 1),
        "xy_factor": (FIX_SENSOR, 0),
        "yaw_factor": (FIX_SENSOR, 1),
    }
    for sensor, name in enumerate(config.localization.sources.pose_sources, FURTHER_SENSORS):
        found |= {f"{name} xy_factor": (sensor, 0), f"{name} yaw_factor": (sensor, 1)}
    return found


def times_of(config: EkfNodeConfig) -> list[str]:
    """Return the names of the correlation times of all sensors, in the order of the parameter ``correlation_times``."""
    names = ("fix", "heading", "landmark", *config.localization.sources.pose_sources)
    return [f"{name}{'_' if sensor < FURTHER_SENSORS else ' '}correlation_time" for sensor, name in enumerate(names)]


def measures(drives: list[Events], sensor: int, angle: int) -> bool:
    """Return True if a sensor measured positions or ranges (``angle`` 0), or angles (1)."""
    measured = [one.measurements for one in drives]
    kinds = {int(kind) for one in measured for kind in np.unique(one.kind[one.sensor == sensor])} - {RESET}
    return any(is_angle(kind, i) == angle for kind in kinds for i in range(size_of(kind)))


def _motion_names(drives: list[Events], config: EkfNodeConfig) -> tuple[str, ...]:
    """Return the names of the quantities of the motion noise: one scale if all messages have a covariance."""
    known = all(bool(one.odometry.covariance.any(axis=1).all()) for one in drives)
    if known and config.localization.odometry.odometry_noise != MOTION:
        return ("odometry_covariance_scale",)
    return Densities._fields


def with_values(settings: Settings, quantities: list[Quantity], values: Array) -> Settings:
    """Return ``settings``, which has the given values, changed to the ``values`` (q,) of the quantities."""
    changes: dict[str, Any] = {"times": settings.times.copy(), "factors": settings.factors.copy()}
    densities = settings.densities._asdict()
    for one, value in zip(quantities, values.tolist(), strict=True):
        if one.place:
            changes[one.field][one.place] = math.exp(value)
        elif one.field in densities:
            densities[one.field] *= math.exp(value)
        else:
            changes[one.field] = getattr(settings, one.field) * math.exp(value) if one.logarithmic else value
    return settings._replace(densities=Densities(**densities), **changes)


def search_settings(settings: Settings, drives: list[Events], config: EkfNodeConfig) -> Settings:
    """Return the settings of the search.

    The constant states start at the given values and have no random walk. The priors of the wheels are wide, and the
    priors of the landmark sensor are the priors of the filter. All errors are independent in time.
    """
    options = settings.options
    errors, sigmas = list(options.errors), np.sqrt(options.variances)
    for name, state in CONSTANTS.items():
        at, angle = state - WHEELS, int(name == "landmark_bearing_offset")
        errors[at] = float(getattr(config.localization.filter, name))
        if state < SENSOR:
            sigmas[at] = _WHEEL_SIGMA
        elif not measures(drives, LANDMARK_SENSOR, angle):
            sigmas[at] = 0.0
    variances = tuple(np.square(sigmas).tolist())
    return settings._replace(
        options=options._replace(errors=tuple(errors), variances=variances, wheel_walk=0.0),  # type: ignore[arg-type]
        by_message=_motion_names(drives, config) == ("odometry_covariance_scale",),
        times=np.zeros_like(settings.times),
    )
