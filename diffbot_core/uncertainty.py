"""Standard deviations of an estimated pose, and the probability that the pose is within a tolerance."""

from __future__ import annotations

import math
from typing import NamedTuple

from diffbot_core.geometry import Pose


class Uncertainty(NamedTuple):
    """Standard deviations of the estimate."""

    xy: float
    """[m] of the position, along the longer axis of its error ellipse"""
    theta: float
    """[rad]"""


CERTAIN = Uncertainty(0.0, 0.0)
"""Of an estimate assumed exact: the default of library calls without an uncertainty.

A message never means this: its all-zero covariance means *unknown*.
"""


class Estimate(NamedTuple):
    """Pose of the robot and its uncertainty, as a controller receives them."""

    pose: Pose
    """in the frame of the goal's pose, e.g. ``map``"""
    uncertainty: Uncertainty = CERTAIN


def largest_deviation(xx: float, xy: float, yy: float) -> float:
    """Return the standard deviation [m] along the longer axis of the error ellipse of a covariance [m^2]."""
    half = 0.5 * (xx + yy)
    spread = math.hypot(0.5 * (xx - yy), xy)
    return math.sqrt(max(half + spread, 0.0))


_ROOT_2 = math.sqrt(2.0)
_CHORD_STEP, _CHORD_TAIL, _MIN_CHORDS = 0.75, 5.0, 6
"""Chords of :func:`disc_probability`: largest step and offset of the last one [deviations], smallest number."""
_FAR = 8.0
"""deviations between mean and bound beyond which the probability is 0 or 1"""
_NONE = 1e-12
"""share of the radius below which a deviation counts as zero; much smaller ones would overflow"""


def disc_probability(offset: float, sigma: float, radius: float) -> float:
    """Return the probability that a position is within ``radius`` of a point, to 1e-5.

    The position is normal about a mean ``offset`` from the point, with deviation ``sigma`` along each axis [m]. The
    chords of the disc along the offset are integrated over an angle. The integrand is smooth and periodic, so the
    trapezoidal rule converges exponentially.
    """
    if sigma <= _NONE * radius:
        return 1.0 if offset <= radius else 0.0
    a, b = offset / sigma, radius / sigma
    if b - a > _FAR:
        return 1.0
    if not b - a > -_FAR:  # or not a number
        return 0.0
    width = 0.5 * math.pi / max(_MIN_CHORDS, math.ceil(0.5 * math.pi * b / _CHORD_STEP))
    total, angle = 0.5 * _chord(a, b, 0.0), width
    while angle < 0.5 * math.pi and b * math.sin(angle) < _CHORD_TAIL:
        total += _chord(a, b, angle)
        angle += width
    return min(2.0 * total * width / math.sqrt(2.0 * math.pi), 1.0)


def _chord(a: float, b: float, angle: float) -> float:
    half, across = b * math.cos(angle), b * math.sin(angle)
    inside = math.erfc((a - half) / _ROOT_2) - math.erfc((a + half) / _ROOT_2)
    return 0.5 * half * math.exp(-0.5 * across * across) * inside


def interval_probability(offset: float, sigma: float, bound: float) -> float:
    """Return the probability that a number, normal about ``offset`` with deviation ``sigma``, is within +-``bound``."""
    if sigma <= 0.0:
        return 1.0 if abs(offset) <= bound else 0.0
    return 0.5 * (math.erfc((offset - bound) / (sigma * _ROOT_2)) - math.erfc((offset + bound) / (sigma * _ROOT_2)))
