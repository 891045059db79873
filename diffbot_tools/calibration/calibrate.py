"""A calibration: fit on every other minute, judged on the minutes between, then fitted on all of them."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from diffbot_control.filter.measurements import Source
from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_tools.calibration.events import FIX, Array, Events, Mask, averaged
from diffbot_tools.calibration.likelihood import Filtered, Prior, run_events, settings_of
from diffbot_tools.calibration.optimise import Fit, Likelihood, constants_of, fit
from diffbot_tools.calibration.quantities import (
    UP,
    Quantity,
    given_prior,
    quantities_of,
    search_prior,
    search_settings,
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
"""Log likelihood that correlated errors of fixes must gain to be believed."""
_LONGEST = 100.0
"""[s] correlation time searched"""


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
    settings = search_settings(settings_of(config), drives, config)
    quantities, prior = quantities_of(drives, config), search_prior(drives, config)
    coarse = [one if settings.noise == DENSITY else averaged(one, PERIOD) for one in drives]
    train = [_every_other(one) for one in coarse]

    def likelihood(use: list[Mask]) -> Likelihood:
        made = Likelihood(coarse, use, settings, prior, quantities)
        made.on_evaluation = on_evaluation
        return made

    measured, seconds = sum(len(one.measurements.time) for one in drives), sum(one.duration for one in drives)
    on_phase(f"{measured} measurements in {seconds:.0f} s; searching {', '.join(one.name for one in quantities)}")
    first = fit(likelihood(train), _starts(quantities))
    if any((one.measurements.kind == FIX).any() for one in drives):
        on_phase("trying errors of the fixes that are correlated in time")
        more = _with_correlation(likelihood(train), first)
        if more is not None:
            settings, quantities, first = more
    complete = likelihood([np.ones(len(one.measurements.time), dtype=bool) for one in coarse])
    on_phase("refining with all measurements; constant errors of wheels and landmarks")
    found = fit(complete, [first.values])
    constants, covariance = constants_of(complete, found)
    on_phase("judging on the half that was held out")
    before = [run_events(one, given_prior(config), settings_of(config)) for one in drives]
    after = [run_events(one, prior, with_values(settings, quantities, first.values)) for one in drives]
    held_out = [~one for one in train]
    return Calibration(
        drives,
        quantities,
        found,
        prior,
        constants,
        covariance,
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
            if one.name.endswith("_factor"):
                start[index] = 0.3 * noise
            elif delay is not None and not one.logarithmic:
                start[index] = delay
        starts.append(start)
    return starts


def _with_correlation(white: Likelihood, first: Fit) -> tuple[Settings, list[Quantity], Fit] | None:
    """Fit with errors of the fixes that last a while; None if the drive does not show that they do."""
    times = np.concatenate([np.diff(one.measurements.time[one.measurements.kind == FIX]) for one in white.drives])
    period = float(np.median(times[times > 0.0])) if (times > 0.0).any() else 1.0
    start = math.log(period)
    extra = Quantity("fix_correlation_time", True, start, math.log(0.1 * period), math.log(_LONGEST), UP, UP)
    quantities = [*white.quantities, extra]
    settings = white.settings._replace(fix_bias=True)
    likelihood = Likelihood(white.drives, white.use, settings, white.prior, quantities)
    likelihood.on_evaluation = white.on_evaluation
    found = fit(likelihood, [np.append(first.values, start)])
    if first.cost - found.cost < _GAIN:
        return None
    return settings, quantities, found


def _judge(drives: list[Events], filtered: list[Filtered], use: list[Mask]) -> Judged:
    innovations: list[Innovation] = []
    total = 0.0
    for number, (events, one, mask) in enumerate(zip(drives, filtered, use, strict=True)):
        measured = events.measurements
        for index in np.flatnonzero(mask & (one.result[:, NUMBERS] > 0.0)).tolist():
            row = one.result[index]
            m = int(row[NUMBERS])
            source = Source(str(number), (float(measured.kind[index]), *measured.place[index].tolist()))
            # Whitened already.
            white = row[WHITE : WHITE + m]
            innovations.append(Innovation(0, source, white, np.eye(m), float(row[NIS]), accepted=True))
            total += float(row[TERM])
    numbers = sum(len(one.y) for one in innovations)
    return Judged(total / max(numbers, 1), consistency_of(innovations))
