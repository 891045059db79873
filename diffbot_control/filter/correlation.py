"""Measurements whose errors last longer than the time between two of them: of one source, or of one landmark.

The error of such a source is taken as a first-order Markov process: after a time dt it is c = exp(-dt / correlation
time) of what it was. In the long run, measurements with independent errors and the covariance R (1 + c) / (1 - c) tell
as much about the pose as those do, and the filter's covariance stays honest.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from diffbot_control.filter.gate import FIX, HEADING, LANDMARK
from diffbot_control.filter.measurements import Heading, LandmarkMeasurement, Measurement, PoseFix
from diffbot_core.geometry import Point
from diffbot_core.units import S_PER_NS

Source = int | Point
"""HEADING, FIX, FIX + 1 and so on for further sources of fixes, or the position of a landmark."""
Stamps = Mapping[Source, int]
"""Stamp [ns] of the newest measurement of each source; never changed in place."""
NO_STAMPS: Stamps = {}
_MIN_DT = 1e-3
"""[s] Measurements of one source that are nearer count as this far apart."""
_KIND_OF = {Heading: HEADING, LandmarkMeasurement: LANDMARK}


def kind_of(measurement: Measurement) -> int:
    """Return HEADING, LANDMARK or FIX, and FIX + 1 and so on for further sources of fixes."""
    if isinstance(measurement, PoseFix):
        return FIX + measurement.source
    return _KIND_OF[type(measurement)]


def source_of(measurement: Measurement) -> Source:
    """Return the source of a measurement: each landmark is one of its own."""
    if isinstance(measurement, LandmarkMeasurement):
        return measurement.landmark
    return kind_of(measurement)


def with_stamp(stamps: Stamps, measurement: Measurement, times: tuple[float, ...]) -> Stamps:
    """Return the stamps after a measurement; ``times``: see :func:`inflation_of`."""
    if times[kind_of(measurement)] == 0.0:
        return stamps
    return {**stamps, source_of(measurement): measurement.stamp}


def inflation_of(stamps: Stamps, measurement: Measurement, times: tuple[float, ...]) -> float:
    """Return (1 + c) / (1 - c), the factor on R of a measurement; 1 for the first of its source.

    Args:
        stamps: of the newest measurements before.
        measurement: the next one.
        times: correlation times [s] by :func:`kind_of`: headings, landmarks, fixes, those of further sources; 0:
            independent errors.
    """
    time, last = times[kind_of(measurement)], stamps.get(source_of(measurement))
    if time == 0.0 or last is None:
        return 1.0
    return inflation_after((measurement.stamp - last) * S_PER_NS, time)


def inflation_after(dt: float, time: float) -> float:
    """Return (1 + c) / (1 - c) with c = exp(-dt / time) for measurements ``dt`` [s] apart; ``time`` > 0 [s]."""
    return 1.0 / math.tanh(0.5 * max(dt, _MIN_DT) / time)
