"""A wheel that begins to slip, or ends, noticed by a gyro: pure functions of floats.

The innovations of the turn rate are white as long as the errors of the wheels are what the filter takes them for. If
they keep a sign, those errors have changed: the radii are made as uncertain as explains it, and are found anew. Where
wheels and gyro agree, nothing is changed. If both wheels slip alike, the turn rate does not show it. Turn rates beyond
the gate do not count: a gyro that is broken must not be explained by slip.
"""

from __future__ import annotations

import math
from typing import NamedTuple

_TIME = 2.0
"""[s] over which the innovations are averaged: longer than accelerations, in which a late gyro disagrees, too"""
_BOUND = 40.0
"""of the squared mean in terms of its variance; white innovations do not reach it"""
_GROWING = 3.0
"""Disagreement in the end over the mean that is found first."""
MAX_SLIP = 0.2
"""Relative error of a radius beyond which no slip is followed."""


class Disagreement(NamedTuple):
    """Of wheels and gyro, after a turn rate."""

    mean: float
    """of the normalised innovations, the weights of older ones falling with their age"""
    variance: float
    """by which the relative error of each radius has become more uncertain; 0 while both agree"""


def add_innovation(mean: float, y: float, S: float, dt: float, by: tuple[float, float]) -> Disagreement:
    """Add the innovation of a turn rate that the gate accepts.

    Args:
        mean: of the normalised innovations before; 0 at the start.
        y: innovation [rad/s].
        S: its variance [rad^2/s^2].
        dt: duration of the step [s].
        by: derivatives of the wheels' turn rate by the relative errors of the radii [rad/s].
    """
    share = dt / (_TIME + dt)
    mean += share * (y / math.sqrt(S) - mean)
    # The mean of white innovations has the variance share / (2 - share).
    if mean * mean * (2.0 - share) <= _BOUND * share:
        return Disagreement(mean, 0.0)
    # Both radii are equally likely to have changed.
    squared, sensitivity = mean * mean * S, by[0] * by[0] + by[1] * by[1]
    if squared > MAX_SLIP * MAX_SLIP * sensitivity:
        return Disagreement(mean, 0.0)  # as of wheels that stand: no slip explains it
    return Disagreement(0.0, min(_GROWING * _GROWING * squared / sensitivity, MAX_SLIP * MAX_SLIP))
