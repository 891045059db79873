"""The numbers that a calibration estimates, and their way into the settings of a filter and into its parameters."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from diffbot_control.filter.options import options_of
from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_tools.calibration.events import FIX, HEADING, LANDMARK, RESET, Array, Events
from diffbot_tools.calibration.likelihood import Prior
from diffbot_tools.calibration.settings import MESSAGE, MOTION, Settings

_DOWN, _SPREAD = 0.2, 3.0
"""Prior deviations of the logarithm of a noise, or of a time. The first is for noise of the motion below the given one,
where landmarks are the only measurements: a drive shows what repeats, not what is right."""
MAX_DELAY = 0.6
"""[s]"""
_MAX_LOG, _MAX_FACTOR_LOG = math.log(1e5), math.log(30.0)
WHEEL_SIGMA, RANGE_OFFSET_SIGMA, RANGE_SCALE_SIGMA, BEARING_OFFSET_SIGMA = 0.1, 0.2, 0.03, 0.05
"""Prior deviations of the constant states: [-], [m], [-], [rad]."""
CONSTANTS = (
    "left_radius_error", "right_radius_error", "wheel_separation_error",
    "landmark_range_offset", "landmark_range_scale", "landmark_bearing_offset",
)  # fmt: skip
"""Constant states of the filter, in the order of :class:`likelihood.Prior`; names of parameters."""


class Quantity(NamedTuple):
    """A number to be estimated by the optimiser: a delay in seconds, or a factor by its logarithm."""

    name: str
    """of a parameter, or of a factor"""
    field: str
    """of :class:`settings.Settings`"""
    place: tuple[int, ...]
    """in that field, if it is an array"""
    logarithmic: bool
    start: float
    """of the optimisation: the delay, or 0 for the given value"""
    lower: float
    upper: float
    down: float = _SPREAD
    """deviation of the prior of a logarithm below the start"""

    @property
    def spread(self) -> float:
        """Deviation of what is thought possible before the drive."""
        return _SPREAD if self.logarithmic else MAX_DELAY / math.sqrt(12.0)

    def penalty(self, value: float) -> float:
        """Return the negative logarithm of the prior at ``value``, up to a constant."""
        away = value - self.start
        return 0.5 * (away / (self.down if away < 0.0 else _SPREAD)) ** 2 if self.logarithmic else 0.0


def quantities_of(drives: list[Events], config: EkfNodeConfig) -> list[Quantity]:
    """Return what can be estimated from drives with these measurements: delay, noise of motion, and of each source."""
    kinds = {int(kind) for one in drives for kind in np.unique(one.measurements.kind)}
    down = _DOWN if LANDMARK in kinds and FIX not in kinds else _SPREAD
    delay = min(config.localization.odometry.odometry_delay, MAX_DELAY)
    found = [Quantity("odometry_delay", "delay", (), False, delay, 0.0, MAX_DELAY)]
    for name in _motion_names(drives, config):
        found.append(Quantity(name, name, (), True, 0.0, -_MAX_LOG, _MAX_LOG, down))
    for name, index, row in factors_of(config):
        if measures(drives, index[0], row):
            found.append(Quantity(name, "factors", index, True, 0.0, -_MAX_FACTOR_LOG, _MAX_FACTOR_LOG))
    if any(len(one.rates.time) > 1 for one in drives):
        found.append(Quantity("gyro_factor", "gyro_factor", (), True, 0.0, -_MAX_FACTOR_LOG, _MAX_FACTOR_LOG))
    return found


def factors_of(config: EkfNodeConfig) -> list[tuple[str, tuple[int, int], int]]:
    """Return name and index of each factor on a deviation of measurements, and a row of R that it is for."""
    found = [
        ("heading_factor", (HEADING, 0), 0),
        ("range_factor", (LANDMARK, 0), 0),
        ("bearing_factor", (LANDMARK, 1), 1),
    ]
    for sensor, prefix in enumerate(("", *(f"{one} " for one in config.localization.sources.pose_sources)), FIX):
        found += [(f"{prefix}xy_factor", (sensor, 0), 0), (f"{prefix}yaw_factor", (sensor, 1), 2)]
    return found


def times_of(config: EkfNodeConfig) -> list[str]:
    """Return the names of the correlation times of all sensors."""
    further = (f"{one} correlation_time" for one in config.localization.sources.pose_sources)
    return ["heading_correlation_time", "landmark_correlation_time", "fix_correlation_time", *further]


def measures(drives: list[Events], sensor: int, row: int) -> bool:
    """Return whether a sensor measured its number in a row of R: of landmarks 0 is the range, 1 the bearing."""
    for _, kind, of, _, _, R, *_ in (one.measurements for one in drives):
        if np.isfinite(R[(of == sensor) & (kind != RESET), row, row]).any():
            return True
    return False


def _motion_names(drives: list[Events], config: EkfNodeConfig) -> tuple[str, ...]:
    if has_covariances(drives) and config.localization.odometry.odometry_noise != "motion":
        return ("odometry_covariance_scale",)
    return "alpha1", "alpha2", "alpha3", "density_xy", "density_theta"


def has_covariances(drives: list[Events]) -> bool:
    """Return whether every odometry message has a covariance."""
    return all(bool(one.odometry.covariance.any(axis=1).all()) for one in drives)


def with_values(settings: Settings, quantities: list[Quantity], values: Array) -> Settings:
    """Return settings with the values of an optimisation; ``settings`` has the given ones."""
    changes: dict[str, Any] = {"times": settings.times.copy(), "factors": settings.factors.copy()}
    for one, value in zip(quantities, values.tolist(), strict=True):
        if one.place:
            changes[one.field][one.place] = math.exp(value)
        else:
            changes[one.field] = getattr(settings, one.field) * math.exp(value) if one.logarithmic else value
    return settings._replace(**changes)


def search_prior(drives: list[Events], config: EkfNodeConfig) -> Prior:
    """Return wide priors of the constant states, around the given values."""
    given = given_prior(config)
    ranges, bearings = measures(drives, LANDMARK, 0), measures(drives, LANDMARK, 1)
    wide = (
        *[WHEEL_SIGMA] * 3,
        RANGE_OFFSET_SIGMA if ranges else 0.0,
        RANGE_SCALE_SIGMA if ranges else 0.0,
        BEARING_OFFSET_SIGMA if bearings else 0.0,
    )
    sigma = np.array(wide)
    # The priors of the landmarks' sensor are those of the filter; where it has none, the search is wide.
    sigma[3:] = np.where((given.sigma[3:] > 0.0) & (sigma[3:] > 0.0), given.sigma[3:], sigma[3:])
    return Prior(given.mean, sigma)


def given_prior(config: EkfNodeConfig) -> Prior:
    """Return the constant states' prior of a configuration."""
    options = config.localization.filter
    calibrating = "calibrating" in options.filter
    radius = options.wheel_radius_sigma if calibrating else 0.0
    separation = options.wheel_separation_sigma if calibrating else 0.0
    mean = [float(getattr(options, name, 0.0)) for name in CONSTANTS]
    landmarks = options_of(options, landmarks=bool(config.landmarks.landmark_ids)).landmark_sigmas
    return Prior(np.array(mean), np.array([radius, radius, separation, *landmarks]))


def search_settings(settings: Settings, drives: list[Events], config: EkfNodeConfig) -> Settings:
    """Return the settings of the search: constant wheel errors, and the noise model whose numbers are estimated.

    All errors are independent at first.
    """
    message = _motion_names(drives, config) == ("odometry_covariance_scale",)
    noise = (settings.noise if settings.noise != MOTION else MESSAGE) if message else MOTION
    return settings._replace(walk=0.0, noise=noise, times=np.zeros_like(settings.times))
