"""Order of measurements by their stamps, and keys by which duplicates are recognised."""

from __future__ import annotations

from typing import Any

from diffbot_control.filter.measurements import Heading, LandmarkMeasurement, Measurement, PoseFix

Key = tuple[int, tuple[float, ...]]
_RANKS = {PoseFix: 0, Heading: 1, LandmarkMeasurement: 2}
"""Order of fusion of measurements with equal stamps."""


def order_of(measurement: Measurement) -> tuple[Any, ...]:
    """Sort by stamp, whatever the order of arrival.

    At equal stamps fixes by source, then headings, then landmarks by position; in each of these by value.
    """
    place: tuple[float, ...] = ()
    if isinstance(measurement, LandmarkMeasurement):
        place = measurement.landmark
    elif isinstance(measurement, PoseFix):
        place = (measurement.source,)
    return measurement.stamp, _RANKS[type(measurement)], place, measurement.values


def key_of(measurement: Measurement) -> Key:
    """Return the key of a measurement: stamp and values."""
    return measurement.stamp, measurement.values


def split_at(measurements: list[Measurement], stamp: int) -> tuple[list[Measurement], list[Measurement]]:
    """Part ordered measurements into those up to ``stamp`` [ns] and those after it."""
    if not measurements or measurements[-1].stamp <= stamp:
        return measurements, []
    ready = [one for one in measurements if one.stamp <= stamp]
    return ready, measurements[len(ready) :]
