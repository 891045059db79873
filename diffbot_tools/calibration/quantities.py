"""The numbers that a calibration estimates, and their way into the settings of a filter and into its parameters."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from diffbot_control.filter.options import options_of
from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_tools.calibration.events import FIX, HEADING, LANDMARK, Array, Events
from diffbot_tools.calibration.likelihood import Prior
from diffbot_tools.calibration.settings import MESSAGE, MOTION, Settings

DOWN, UP = 0.2, 3.0
"""Prior deviations of ln(noise / given) below and above the given value, where landmarks are the only measurements: a
drive shows what repeats, not what is right, so raising noise is free, and lowering it costs."""
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
    """parameter, or factor of :class:`settings.Settings`"""
    logarithmic: bool
    start: float
    """of the optimisation: the delay, or 0 for the given value"""
    lower: float
    upper: float
    down: float
    """deviation of the prior below the start; inf: none"""
    up: float
    """deviation of the prior above the start"""

    @property
    def spread(self) -> float:
        """Deviation of what is thought possible before the drive."""
        return self.up if self.logarithmic else MAX_DELAY / math.sqrt(12.0)

    def penalty(self, value: float) -> float:
        """Return the negative logarithm of the prior at ``value``, up to a constant."""
        if not self.logarithmic:
            return 0.0
        away = value - self.start
        return 0.5 * (away / (self.down if away < 0.0 else self.up)) ** 2


def quantities_of(drives: list[Events], config: EkfNodeConfig) -> list[Quantity]:
    """Return what can be estimated from drives with these measurements: delay, noise of motion, and of each source."""
    kinds = {int(kind) for one in drives for kind in np.unique(one.measurements.kind)}
    lowering = DOWN if LANDMARK in kinds and FIX not in kinds else UP
    delay = config.localization.odometry.odometry_delay
    found = [Quantity("odometry_delay", False, min(delay, MAX_DELAY), 0.0, MAX_DELAY, math.inf, math.inf)]
    for name in _motion_names(drives, config):
        found.append(Quantity(name, True, 0.0, -_MAX_LOG, _MAX_LOG, lowering, UP))
    factors = {"xy_factor": FIX, "yaw_factor": FIX, "heading_factor": HEADING}
    for name, kind in factors.items():
        if kind in kinds:
            found.append(Quantity(name, True, 0.0, -_MAX_FACTOR_LOG, _MAX_FACTOR_LOG, UP, UP))
    for row, name in enumerate(("range_factor", "bearing_factor")):
        if measures(drives, row):
            # Ranges repeat, which makes them look better than they are: never below the given deviation.
            found.append(Quantity(name, True, 0.0, 0.0, _MAX_FACTOR_LOG, UP, UP))
    return found


def measures(drives: list[Events], row: int) -> bool:
    """Return whether landmarks were measured with this number: 0 range, 1 bearing."""
    return any(
        bool(np.isfinite(one.measurements.R[one.measurements.kind == LANDMARK, row, row]).any()) for one in drives
    )


def _motion_names(drives: list[Events], config: EkfNodeConfig) -> tuple[str, ...]:
    if has_covariances(drives) and config.localization.odometry.odometry_noise != "motion":
        return ("odometry_covariance_scale",)
    return "alpha1", "alpha2", "alpha3", "density_xy", "density_theta"


def has_covariances(drives: list[Events]) -> bool:
    """Return whether every odometry message has a covariance."""
    return all(bool(one.odometry.covariance.any(axis=1).all()) for one in drives)


def with_values(settings: Settings, quantities: list[Quantity], values: Array) -> Settings:
    """Return settings with the values of an optimisation; ``settings`` has the given ones."""
    changes: dict[str, Any] = {}
    for one, value in zip(quantities, values.tolist(), strict=True):
        if one.name == "odometry_delay":
            changes["delay"] = value
        elif one.name == "fix_correlation_time":
            changes["times"] = (*settings.times[:2], math.exp(value))
        else:
            changes[one.name] = getattr(settings, one.name) * math.exp(value)
    return settings._replace(**changes)


def search_prior(drives: list[Events], config: EkfNodeConfig) -> Prior:
    """Return wide priors of the constant states, around the given values."""
    given = given_prior(config)
    ranges, bearings = measures(drives, 0), measures(drives, 1)
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
    """Return the settings of the search: constant wheel errors, and the noise model whose numbers are estimated."""
    message = _motion_names(drives, config) == ("odometry_covariance_scale",)
    noise = (settings.noise if settings.noise != MOTION else MESSAGE) if message else MOTION
    return settings._replace(walk=0.0, noise=noise)
