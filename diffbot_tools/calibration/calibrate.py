"""A calibration: fit on every other minute, judged on the minutes between, then fitted on all of them."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from diffbot_control.filter.measurements import Source
from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_sim.compiled.ekf import GYRO
from diffbot_tools.calibration.events import Array, Events, Mask, averaged, with_error_states
from diffbot_tools.calibration.likelihood import Filtered, Prior, run_events, settings_of
from diffbot_tools.calibration.optimise import Fit, Likelihood, constants_of, fit
from diffbot_tools.calibration.quantities import (
    Quantity,
    given_prior,
    quantities_of,
    search_prior,
    search_settings,
    times_of,
    with_values,
)
from diffbot_tools.calibration.settings import DENSITY, NIS, NUMBERS, TERM, WHITE, Settings
from diffbot_tools.refilter.comparison import Consistency, consistency_of
from diffbot_tools.refilter.filter_run import Innovation

PERIOD = 0.05
"""[s] over which odometry is averaged in the search"""
_BLOCK, _MIN_BLOCKS = 60.0, 6
"""[s] held-out parts, shorter if a drive would have fewer than this"""
_GAIN = 3.0
"""Log likelihood that correlated errors of a sensor must gain to be believed."""
_LONGEST = 100.0
"""[s] correlation time searched"""
_PERIODS = (0.5, 2.0, 8.0)
"""Correlation times from which the search starts, in periods of the sensor."""


class Judged(NamedTuple):
    """Innovations of the held-out parts."""

    log_likelihood: float
    """per measured number"""
    consistency: Consistency


class Calibration(NamedTuple):
    """What was found."""

    drives: list[Events]
    quantities: list[Quantity]
    found: Fit
    """of all measurements"""
    prior: Prior
    """of the constant states"""
    constants: Array
    """(6,) their means"""
    constants_covariance: Array
    """(6, 6)"""
    biases: list[tuple[float, float]]
    """of the gyro at the end of each drive that has one, and its deviation [rad/s]"""
    settings: Settings
    """of the search, at the given values"""
    before: Judged
    after: Judged


def calibrate(
    drives: list[Events],
    config: EkfNodeConfig,
    on_evaluation: Callable[[], object],
    on_phase: Callable[[str], object] = lambda _: None,
) -> Calibration:
    """Calibrate a robot.

    Args:
        drives: recorded with one robot.
        config: given parameters.
        on_evaluation: called after each evaluation of the likelihood, in any thread.
        on_phase: called with a text for each part of the work that begins.
    """
    given = settings_of(config)
    settings = search_settings(given, drives, config)
    quantities, prior = quantities_of(drives, config), search_prior(drives, config)
    coarse = [one if settings.noise == DENSITY else averaged(one, PERIOD) for one in drives]
    train = [_every_other(one) for one in coarse]

    measured, seconds = sum(len(one.measurements.time) for one in drives), sum(one.duration for one in drives)
    on_phase(f"{measured} measurements in {seconds:.0f} s; searching {', '.join(one.name for one in quantities)}")
    likelihood = Likelihood(coarse, train, settings, prior, quantities, on_evaluation)
    first = fit(likelihood, _starts(quantities))
    for sensor, name in enumerate(times_of(config)):
        if any((one.measurements.sensor == sensor).any() for one in drives):
            on_phase(f"trying {name}: errors that are correlated in time")
            needed = _GAIN if given.times[sensor] == 0.0 else -math.inf
            more = _with_correlation(likelihood, first, name, sensor, needed)
            if more is not None:
                likelihood, first = more
    quantities = likelihood.quantities
    on_phase("refining with all measurements; constant errors of wheels and landmarks")
    likelihood.use = [np.ones(len(one.measurements.time), dtype=bool) for one in coarse]
    found = fit(likelihood, [first.values])
    constants, covariance = constants_of(likelihood, found)
    ends, bias = likelihood.filtered(found.values), GYRO - 1
    on_phase("judging on the half that was held out")
    before = [run_events(one, given_prior(config), given) for one in drives]
    sensors = {one.place[0] for one in quantities if one.field == "times"}
    found_settings = with_values(settings, quantities, first.values)
    after = [run_events(with_error_states(one, sensors), prior, found_settings) for one in drives]
    held_out = [~one for one in train]
    return Calibration(
        drives,
        quantities,
        found,
        prior,
        constants,
        covariance,
        [(float(one.x[bias]), math.sqrt(one.P[bias, bias])) for one in ends if one.P[bias, bias] > 0.0],
        settings,
        _judge(drives, before, held_out),
        _judge(drives, after, held_out),
    )


def _every_other(events: Events) -> Mask:
    """Return a mask (k,) of the measurements in the even blocks of time."""
    block = min(_BLOCK, events.duration / _MIN_BLOCKS)
    even: Mask = np.floor_divide(events.measurements.time, block) % 2.0 == 0.0
    return even


def _starts(quantities: list[Quantity]) -> list[Array]:
    """Return the given values, and two starts with more noise and other delays."""
    starts = []
    for delay, noise in ((None, 0.0), (0.15, 2.0), (0.3, 5.0)):
        start = np.array([one.start + (noise if one.logarithmic else 0.0) for one in quantities])
        for index, one in enumerate(quantities):
            if one.field == "factors":
                start[index] = 0.3 * noise
            elif delay is not None and not one.logarithmic:
                start[index] = delay
        starts.append(start)
    return starts


def _with_correlation(
    white: Likelihood, first: Fit, name: str, sensor: int, needed: float
) -> tuple[Likelihood, Fit] | None:
    """Fit with errors of a sensor that last a while; None if the log likelihood does not gain what is ``needed``."""
    quantities, period = white.quantities, _period(white.drives, sensor)
    if period is None:
        return None
    sensors = {one.place[0] for one in quantities if one.field == "times"} | {sensor}
    lower = math.log(0.1 * period)
    extra = Quantity(name, "times", (sensor,), True, math.log(period), lower, math.log(_LONGEST))
    drives = [with_error_states(one, sensors) for one in white.drives]
    all_quantities = [*quantities, extra]
    likelihood = Likelihood(drives, white.use, white.settings, white.prior, all_quantities, white.on_evaluation)
    starts = [np.append(first.values, math.log(factor * period)) for factor in _PERIODS]
    costs = [likelihood.cost(one) for one in starts]
    best = int(np.argmin(costs))
    if first.cost - costs[best] < min(needed, 0.0):
        return None
    found = fit(likelihood, [starts[best]])
    return (likelihood, found) if first.cost - found.cost >= needed else None


def _period(drives: list[Events], sensor: int) -> float | None:
    """Return the usual time [s] between two measurements of one source of a sensor; None if there are none."""
    gaps = np.concatenate([one.measurements.gap[one.measurements.sensor == sensor] for one in drives])
    gaps = gaps[np.isfinite(gaps) & (gaps > 0.0)]
    return float(np.median(gaps)) if gaps.size else None


def _judge(drives: list[Events], filtered: list[Filtered], use: list[Mask]) -> Judged:
    innovations: list[Innovation] = []
    total = 0.0
    for number, (events, one, mask) in enumerate(zip(drives, filtered, use, strict=True)):
        measured = events.measurements
        for index in np.flatnonzero(mask & (one.result[:, NUMBERS] > 0.0)).tolist():
            row = one.result[index]
            m = int(row[NUMBERS])
            source = Source(str(number), (float(measured.source[index]),))
            # Whitened already.
            white = row[WHITE : WHITE + m]
            innovations.append(Innovation(0, source, white, np.eye(m), float(row[NIS]), accepted=True))
            total += float(row[TERM])
    numbers = sum(len(one.y) for one in innovations)
    return Judged(total / max(numbers, 1), consistency_of(innovations))
