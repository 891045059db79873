"""Likelihood of the innovations of a drive, by the compiled filter."""

from __future__ import annotations

import functools
import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from diffbot_control.filter import correlation, odometry_noise
from diffbot_control.filter.options import options_of
from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_core.code_hash import hash_of_folders
from diffbot_sim.compiled.ekf import GYRO, LANDMARKS, POSE
from diffbot_tools.calibration import kernel
from diffbot_tools.calibration.events import Array, Events, Mask
from diffbot_tools.calibration.settings import COLUMNS, RATES, TERM, Settings


class Prior(NamedTuple):
    """Constant states before the drive: errors of the radii and the separation, range offset, scale, bearing offset."""

    mean: Array
    """(6,)"""
    sigma: Array
    """(6,) standard deviations"""


class Filtered(NamedTuple):
    """A drive at the filter."""

    result: Array
    """(k, COLUMNS) figures of each measurement, see :mod:`kernel`"""
    x: Array
    """(n,) states at the end"""
    P: Array
    """(n, n) their covariance"""


def settings_of(config: EkfNodeConfig) -> Settings:
    """Return the numbers of a configuration."""
    localization, odometry = config.localization, config.localization.odometry
    ekf = localization.filter
    options = options_of(ekf)
    names = (odometry_noise.MESSAGE, odometry_noise.DENSITY, odometry_noise.MOTION)
    further = localization.sources.settings()
    times = (ekf.heading_correlation_time, ekf.landmark_correlation_time, ekf.fix_correlation_time)
    return Settings(
        config.wheels.wheel_separation,
        options.radius_random_walk,
        odometry.odometry_delay,
        names.index(odometry.odometry_noise),
        odometry.odometry_covariance_scale,
        odometry.alpha1,
        odometry.alpha2,
        odometry.alpha3,
        odometry.alpha4,
        odometry.density_xy,
        odometry.density_theta,
        options.gates,
        np.array([*times, *(one.correlation_time for one in further)]),
        np.ones((len(times) + len(further) + 1, 2)),
        gyro_factor=1.0,
        gyro_bias_variance=options.gyro_bias_variance,
        gyro_bias_walk=options.gyro_bias_random_walk,
        split=False,
    )


def run_events(events: Events, prior: Prior, settings: Settings) -> Filtered:
    """Filter a drive; the compiled code releases the interpreter's lock."""
    arrays = np.zeros(1, kernel.filter_type(GYRO + events.errors))
    x, P = arrays[0]["belief"]
    constants = slice(POSE, LANDMARKS)
    x[constants] = prior.mean
    np.fill_diagonal(P[constants, constants], np.square(prior.sigma))
    P[LANDMARKS, LANDMARKS] = settings.gyro_bias_variance
    result = np.zeros((len(events.measurements.time), COLUMNS))
    compiled()(events, arrays, result, settings)
    return Filtered(result, x, P)


def log_likelihood(found: Filtered, use: Mask) -> float:
    """Return the sum over the measurements in ``use`` (k,), a mask; -inf if the filter has broken down."""
    total = float(found.result[use][:, (TERM, RATES)].sum())
    return total if math.isfinite(total) else -math.inf


@functools.cache
def compiled() -> Any:
    """Return the compiled :func:`kernel.run_filter`.

    Raises:
        DiffbotError: if numba is not installed.
    """
    # Loads numba, and so not at the import of this module.
    from diffbot_sim.compiled.jit import LIBRARIES, compile_kernel, make_callable  # noqa: PLC0415

    for function in (correlation.inflation_after, odometry_noise.motion_density, odometry_noise.over_time):
        make_callable(function)
    for helper in kernel.CALLED:
        make_callable(helper, inline=False)
    return compile_kernel(kernel.run_filter, hash_of_folders([Path(kernel.__file__).parent], LIBRARIES))
