"""Calibrate a robot: fit every other minute, evaluate the fit on the minutes between, then fit all minutes."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from diffbot_control.filter.models import BIAS
from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_tools.calibration.events import (
    Array,
    Events,
    Mask,
    averaged,
    with_error_states,
    with_noise_of_neighbours,
    with_noise_of_wheels,
)
from diffbot_tools.calibration.fit import Fit, Likelihood, constants_of, fit, joined_constants
from diffbot_tools.calibration.kernel import NUMBERS, TERM, WHITE, Filtered, Settings, run_events, settings_of
from diffbot_tools.calibration.quantities import Quantity, quantities_of, search_settings, times_of, with_values
from diffbot_tools.filter_statistics import Consistency, consistency_of

_AVERAGING_PERIOD = 0.05
"""[s] period over which odometry is averaged in the search"""
_BLOCK, _MIN_BLOCKS = 60.0, 6
"""[s] Length of each held-out part, and the smallest number of parts. A shorter drive has shorter parts."""
_GAIN = 3.0
"""A model with time-correlated errors is accepted if it increases the log likelihood by at least this."""
_MAX_CORRELATION_TIME = 100.0
"""[s] largest correlation time of the search"""
_CORRELATION_STARTS = (0.5, 2.0, 8.0)
"""Correlation times at which the search starts, in periods of the sensor."""
_STARTS = ((None, 0.0), (0.15, 2.0), (0.3, 5.0))
"""Starts of the search: delay [s] (None: the given delay), and the amount added to the logarithms of the noise."""


class HeldOutFigures(NamedTuple):
    """Figures of the innovations of the held-out parts."""

    log_likelihood: float
    """per measured number"""
    consistency: Consistency


class Calibration(NamedTuple):
    """Result of a calibration."""

    drives: list[Events]
    quantities: list[Quantity]
    found: Fit
    """fit of the quantities to all measurements"""
    constants: Array
    """(6,) means of the constant states, in the order of CONSTANTS"""
    constants_covariance: Array
    """(6, 6)"""
    biases: list[tuple[float, float]]
    """bias of the gyro at the end of each drive with a gyro, and its standard deviation [rad/s]"""
    settings: Settings
    """settings of the search, with the given values and the priors of the constant states"""
    before: HeldOutFigures
    """with the given parameters"""
    after: HeldOutFigures
    """with the parameters of the fit to the other half"""


def calibrate(
    drives: list[Events],
    config: EkfNodeConfig,
    on_evaluation: Callable[[], object],
    on_phase: Callable[[str], object] = lambda _: None,
) -> Calibration:
    """Calibrate a robot.

    Args:
        drives: drives of one robot.
        config: given parameters.
        on_evaluation: called after each evaluation of the likelihood, in any thread.
        on_phase: called with a text at the start of each part of the work.
    """
    given = settings_of(config)
    settings, quantities = search_settings(given, drives, config), quantities_of(drives, config)
    coarse = [with_noise_of_neighbours(averaged(one, _AVERAGING_PERIOD)) for one in drives]
    train = [_every_other(one) for one in coarse]
    measured, seconds = sum(len(one.measurements.time) for one in drives), sum(one.duration for one in drives)
    on_phase(f"{measured} measurements in {seconds:.0f} s; searching {', '.join(one.name for one in quantities)}")
    likelihood = Likelihood(coarse, train, settings, quantities, on_evaluation)
    first = fit(likelihood, [_start_values(quantities, *one) for one in _STARTS])
    for sensor, name in enumerate(times_of(config)):
        if any((one.measurements.sensor == sensor).any() for one in drives):
            on_phase(f"trying {name}: errors that are correlated in time")
            needed = _GAIN if given.times[sensor] == 0.0 else -math.inf
            likelihood, first = _with_correlation(likelihood, first, name, sensor, needed)
    quantities = likelihood.quantities
    on_phase("refining with all measurements; estimating constant errors of wheels and landmarks")
    wheels, _ = joined_constants(likelihood, first.values)
    likelihood = likelihood._replace(
        drives=[with_noise_of_wheels(one, wheels[:3], settings.options.separation) for one in likelihood.drives],
        use=[np.ones(len(one.measurements.time), dtype=bool) for one in coarse],
    )
    found = fit(likelihood, [first.values])
    ends = likelihood.filtered(found.values)
    on_phase("evaluating the half that was held out")
    held_out, found_settings = [~one for one in train], with_values(settings, quantities, first.values)
    after = [run_events(with_error_states(one, _correlated_sensors(quantities)), found_settings) for one in drives]
    return Calibration(
        drives,
        quantities,
        found,
        *constants_of(likelihood, found),
        [(float(one.x[BIAS]), math.sqrt(one.P[BIAS, BIAS])) for one in ends if one.P[BIAS, BIAS] > 0.0],
        settings,
        _held_out_figures(drives, [run_events(one, given) for one in drives], held_out),
        _held_out_figures(drives, after, held_out),
    )


def _every_other(events: Events) -> Mask:
    """Return a mask (k,) of the measurements in the even blocks of time."""
    block = min(_BLOCK, events.duration / _MIN_BLOCKS)
    even: Mask = np.floor_divide(events.measurements.time, block) % 2.0 == 0.0
    return even


def _start_values(quantities: list[Quantity], delay: float | None, noise: float) -> Array:
    """Return the values (q,) at which the search starts. Sensor noise is increased less than motion noise."""
    start = np.array([one.start + (noise if one.logarithmic else 0.0) for one in quantities])
    for index, one in enumerate(quantities):
        if one.field == "factors":
            start[index] = 0.3 * noise
        elif delay is not None and not one.logarithmic:
            start[index] = delay
    return start


def _correlated_sensors(quantities: list[Quantity]) -> set[int]:
    """Return the sensors whose errors are correlated in time."""
    return {one.place[0] for one in quantities if one.field == "times"}


def _with_correlation(white: Likelihood, first: Fit, name: str, sensor: int, needed: float) -> tuple[Likelihood, Fit]:
    """Fit a model with time-correlated errors of a sensor.

    Return the given model and its fit if the log likelihood increases by less than ``needed``.
    """
    gaps = np.concatenate([with_error_states(one, {sensor}).measurements.gap for one in white.drives])
    gaps = gaps[np.isfinite(gaps) & (gaps > 0.0)]
    if not gaps.size:
        return white, first
    period = float(np.median(gaps))
    time = Quantity(
        name, "times", (sensor,), True, math.log(period), math.log(0.1 * period), math.log(_MAX_CORRELATION_TIME)
    )
    quantities = [*white.quantities, time]
    drives = [with_error_states(one, _correlated_sensors(quantities)) for one in white.drives]
    likelihood = white._replace(drives=drives, quantities=quantities)
    starts = [np.append(first.values, math.log(factor * period)) for factor in _CORRELATION_STARTS]
    costs = [likelihood.cost(one) for one in starts]
    best = int(np.argmin(costs))
    if first.cost - costs[best] < min(needed, 0.0):
        return white, first
    found = fit(likelihood, [starts[best]])
    return (likelihood, found) if first.cost - found.cost >= needed else (white, first)


def _held_out_figures(drives: list[Events], filtered: list[Filtered], use: list[Mask]) -> HeldOutFigures:
    """Return the figures of the measurements in ``use``.

    The lag-1 correlation pairs only innovations of the same drive, source and kind.
    """
    rows, sources = [], []
    for drive, (events, one, mask) in enumerate(zip(drives, filtered, use, strict=True)):
        index = np.flatnonzero(mask & (one.result[:, NUMBERS] > 0.0))
        rows.append(one.result[index])
        measured = events.measurements
        sources.append(np.stack((np.full(len(index), drive), measured.source[index], measured.kind[index]), axis=1))
    every, (_, source) = np.concatenate(rows), np.unique(np.concatenate(sources), axis=0, return_inverse=True)
    numbers = every[:, NUMBERS]
    log_likelihood = float(every[:, TERM].sum() / max(numbers.sum(), 1.0))
    return HeldOutFigures(log_likelihood, consistency_of(every[:, WHITE:], numbers, source.reshape(-1)))
