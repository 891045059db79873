"""How long the errors of fixes last, found from the fixes themselves: pure functions with their memory.

If the error of a fix is c times that of the fix before plus something new, two numbers show it. The difference of
neighbouring fixes, less what the odometry says in between, has the variance 2 R (1 - c) and that of the motion; a drift
of the estimate cancels in it. And neighbouring innovations have a product of positive mean, while those of a filter
whose R is merely too large do not. The smaller of both answers counts, if the second is significant.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from diffbot_control.filter.models import Motion, pose_innovation
from diffbot_core.geometry import Pose

_MEMORY = 1.0 / 200.0
"""Share of the newest fix in the slow means."""
_SIGNIFICANT = 2.0
"""[standard deviations] of the mean product of white innovations"""
_MAX_CORRELATION = 0.99
_MAX_SQUARE = 30.0
"""Bound of a normalised square: a single outlier must not dominate the mean."""
_SIZE = 3
"""Numbers of a fix."""


class Travelled(NamedTuple):
    """Variance that the motion since a fix has added."""

    along: float
    """[m^2]"""
    turn: float
    """[rad^2]"""


class Colour(NamedTuple):
    """Memory of the search for correlated errors of fixes."""

    paired: bool
    """False if the newest fix was not accepted: the next one has no partner"""
    innovation: Pose
    """of the newest fix: measured minus expected pose"""
    residual: Pose
    """the same after its correction"""
    estimate: Pose
    """after its correction"""
    var_theta: float
    """[rad^2] of that estimate"""
    difference: float
    """mean of half the squared difference of neighbours over R; 1 - c is expected, and the motion's part"""
    motion: float
    """mean of the motion's part"""
    product: float
    """mean product of neighbouring innovations over R"""
    pairs: int
    """number of pairs so far"""
    inflation: float
    """factor on R: (1 + c) / (1 - c)"""


_ZERO = Pose(0.0, 0.0, 0.0)
STANDING = Travelled(0.0, 0.0)


def new_colour() -> Colour:
    """Return the memory before the first fix: independent errors."""
    return Colour(False, _ZERO, _ZERO, _ZERO, 0.0, 1.0, 0.0, 0.0, 0, 1.0)


def unpaired(colour: Colour) -> Colour:
    """Return the memory after a fix that was not accepted, or a jump of the estimate."""
    return Colour(
        False,
        colour.innovation,
        colour.residual,
        colour.estimate,
        colour.var_theta,
        colour.difference,
        colour.motion,
        colour.product,
        colour.pairs,
        colour.inflation,
    )


def travel(travelled: Travelled, motion: Motion, var_lateral: float) -> Travelled:
    """Add a motion; ``var_lateral`` is its variance across the robot [m^2]."""
    var_v, _, var_omega = motion.covariance
    squared = motion.dt * motion.dt
    return Travelled(travelled.along + squared * var_v + var_lateral, travelled.turn + squared * var_omega)


def with_fix(
    colour: Colour,
    travelled: Travelled,
    fix: Pose,
    variances: tuple[float, float, float],
    before: Pose,
    after: Pose,
    var_theta: float,
) -> Colour:
    """Update the memory with an accepted fix.

    Args:
        colour: the memory.
        travelled: since the fix before.
        fix: the measured pose.
        variances: of its errors, as claimed [m^2, m^2, rad^2].
        before: the estimate before its correction.
        after: the estimate after it.
        var_theta: of that estimate [rad^2].
    """
    y, residual = pose_innovation(fix, before), pose_innovation(fix, after)
    if not colour.paired:
        return Colour(True, y, residual, after, var_theta, *_means(colour))
    last, old = colour.innovation, colour.residual
    by_x, by_y, by_theta = 1.0 / variances[0], 1.0 / variances[1], 1.0 / variances[2]
    turned = pose_innovation(y, old)
    r_x, r_y, r_theta = turned
    dx, dy = before.x - colour.estimate.x, before.y - colour.estimate.y
    # An error of the heading turns what was driven: it moves the end across.
    moved = 0.5 * (travelled.along + (dx * dx + dy * dy) * colour.var_theta) * (by_x + by_y)
    half = 0.5 / _SIZE
    difference = half * (r_x * r_x * by_x + r_y * r_y * by_y + r_theta * r_theta * by_theta)
    motion = half * (moved + travelled.turn * by_theta)
    product = (y.x * last.x * by_x + y.y * last.y * by_y + y.theta * last.theta * by_theta) / _SIZE
    share = max(_MEMORY, 1.0 / (colour.pairs + 1.0))
    difference = colour.difference + share * (min(difference, _MAX_SQUARE) - colour.difference)
    motion = colour.motion + share * (min(motion, _MAX_SQUARE) - colour.motion)
    bounded = min(max(product, -_MAX_SQUARE), _MAX_SQUARE)
    product = colour.product + share * (bounded - colour.product)
    c = correlation_of(difference, motion, product, 1.0 / share)
    inflation = (1.0 + c) / (1.0 - c)
    return Colour(True, y, residual, after, var_theta, difference, motion, product, colour.pairs + 1, inflation)


def _means(colour: Colour) -> tuple[float, float, float, int, float]:
    return colour.difference, colour.motion, colour.product, colour.pairs, colour.inflation


def correlation_of(difference: float, motion: float, product: float, pairs: float) -> float:
    """Return c from the means over ``pairs`` pairs of fixes, see :class:`Colour`."""
    # White innovations have a product of mean 0; its deviation is their variance over the root of the number.
    noise = max(difference - motion, 1e-3)
    if product <= _SIGNIFICANT * (difference + product) / math.sqrt(_SIZE * pairs):
        return 0.0
    by_difference = 1.0 + motion - difference
    by_product = product / (product + noise)
    return min(max(min(by_difference, by_product), 0.0), _MAX_CORRELATION)
