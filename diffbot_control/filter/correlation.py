"""Measurements whose errors last longer than the time between two of them: of one source, or of one landmark.

The error of such a source is taken as a first-order Markov process: after a time dt it is c = exp(-dt / correlation
time) of what it was. In the long run, measurements with independent errors and the covariance R (1 + c) / (1 - c) tell
as much about the pose as those do, and the filter's covariance stays honest.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from diffbot_control.filter.measurements import Measurement, Source
from diffbot_core.units import S_PER_NS

Times = Mapping[str, float]
"""How long errors last [s], by the name of the sensor; 0 or none: independent errors."""
Stamps = Mapping[Source, int]
"""Stamp [ns] of the newest measurement of each source; never changed in place."""
NO_STAMPS: Stamps = {}
MIN_DT = 1e-3
"""[s] Measurements of one source that are nearer count as this far apart."""


def with_stamp(stamps: Stamps, measurement: Measurement, times: Times) -> Stamps:
    """Return the stamps after a measurement."""
    source = measurement.source
    return {**stamps, source: measurement.stamp} if times.get(source.sensor, 0.0) > 0.0 else stamps


def inflation_of(stamps: Stamps, measurement: Measurement, times: Times) -> float:
    """Return (1 + c) / (1 - c), the factor on R of a measurement; 1 for the first of its source.

    Args:
        stamps: of the newest measurements before.
        measurement: the next one.
        times: of the sensors.
    """
    source = measurement.source
    time, last = times.get(source.sensor, 0.0), stamps.get(source)
    if time == 0.0 or last is None:
        return 1.0
    return inflation_after((measurement.stamp - last) * S_PER_NS, time)


def inflation_after(dt: float, time: float) -> float:
    """Return (1 + c) / (1 - c) with c = exp(-dt / time) for measurements ``dt`` [s] apart; ``time`` > 0 [s]."""
    return 1.0 / math.tanh(0.5 * max(dt, MIN_DT) / time)


def correlation_over(periods: Sequence[float], time: float) -> float:
    """Return the mean correlation of two errors that are ``periods`` [s] apart; 0 if they are independent.

    Args:
        periods: times between two measurements [s].
        time: how long errors last [s]; 0: independent.
    """
    if time == 0.0 or not periods:
        return 0.0
    return sum(math.exp(-max(dt, MIN_DT) / time) for dt in periods) / len(periods)
