"""Uncertainty of an estimated pose, and the probability that the true pose is within a tolerance."""

from __future__ import annotations

import math
from typing import NamedTuple

from diffbot_core.geometry import Pose


class Uncertainty(NamedTuple):
    """Standard deviations of the estimate."""

    xy: float
    """[m] standard deviation of the position along the longer axis of its error ellipse"""
    theta: float
    """[rad]"""


CERTAIN = Uncertainty(0.0, 0.0)
"""Uncertainty of an estimate that is assumed to be exact. An all-zero covariance in a message means *unknown*."""


class Estimate(NamedTuple):
    """Estimated pose of the robot and its uncertainty."""

    pose: Pose
    """in the frame in which the goal is given, e.g. ``map``"""
    uncertainty: Uncertainty = CERTAIN


def largest_deviation(xx: float, xy: float, yy: float) -> float:
    """Return the standard deviation [m] along the longer axis of the error ellipse of a covariance [m^2]."""
    half = 0.5 * (xx + yy)
    spread = math.hypot(0.5 * (xx - yy), xy)
    return math.sqrt(max(half + spread, 0.0))


_ROOT_2 = math.sqrt(2.0)
_CHORD_STEP, _CHORD_TAIL, _MIN_CHORDS = 0.75, 5.0, 6
"""Chords in :func:`disc_probability`: largest step [sigmas], offset of the last chord [sigmas], smallest number."""
_MAX_SIGMAS = 8.0
"""[sigmas] between mean and bound; beyond it, the probability is 0 or 1"""
_MIN_RATIO = 1e-12
"""Smaller ratios of sigma and radius count as zero, because their inverse would overflow."""


def disc_probability(offset: float, sigma: float, radius: float) -> float:
    """Return the probability, with an error below 1e-5, that a position is within ``radius`` of a point.

    The position has a normal distribution with standard deviation ``sigma`` along each axis. Its mean is ``offset``
    away from the point. The probabilities of the chords of the disc parallel to the offset are integrated over an
    angle. The integrand is smooth and periodic, so the trapezoidal rule converges exponentially.

    Args:
        offset: [m]
        sigma: [m]
        radius: [m]
    """
    if sigma <= _MIN_RATIO * radius:
        return 1.0 if offset <= radius else 0.0
    a, b = offset / sigma, radius / sigma
    if b - a > _MAX_SIGMAS:
        return 1.0
    if not b - a > -_MAX_SIGMAS:  # also if it is nan
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
    """Return the probability that a normal variable with mean ``offset`` and ``sigma`` is within +-``bound``."""
    if sigma <= 0.0:
        return 1.0 if abs(offset) <= bound else 0.0
    return 0.5 * (math.erfc((offset - bound) / (sigma * _ROOT_2)) - math.erfc((offset + bound) / (sigma * _ROOT_2)))
