"""How long the errors of fixes last, found from the fixes themselves: pure functions with their memory.

If the error of a fix is c times that of the fix before plus something new, two numbers show it. The difference of
neighbouring fixes, less the odometry's displacement between them, has the variance 2 R (1 - c) and that of the motion;
a drift of the estimate cancels in it. And neighbouring innovations have a product of positive mean, while those of a
filter whose R is merely too large do not. The smaller of both answers counts, if the second is significant.
"""

from __future__ import annotations

from typing import NamedTuple

from diffbot_control.filter.models import Motion, covariance_with_rate, gyro_share, heading_innovation
from diffbot_core.geometry import Pose, wrap_angle

MEMORY = 200
"""Pairs of fixes that the slow means remember."""
_SIGNIFICANT = 2.0
"""[standard deviations] of the mean product of white innovations"""
_MAX_CORRELATION = 0.99
MAX_SQUARE = 30.0
"""Bound of a normalised square: an outlier that no gate kept out has no partner."""
Numbers = tuple[float, float, float]
"""x [m], y [m], theta [rad]"""


class Variances(NamedTuple):
    """Of a fix."""

    x: float
    """[m^2]"""
    y: float
    """[m^2]"""
    theta: float
    """[rad^2]; inf: it has no heading"""


class Travelled(NamedTuple):
    """Variance that the motion since a fix has added."""

    along: float
    """[m^2]"""
    turn: float
    """[rad^2]"""


class FixCorrelation(NamedTuple):
    """Memory of the search for correlated errors of fixes."""

    paired: bool
    """False if the newest fix was not accepted: the next one has no partner"""
    innovation: Numbers
    """of the newest fix: measured minus expected pose"""
    residual: Numbers
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
    """number of pairs so far, up to those remembered"""
    inflation: float
    """factor on R: (1 + c) / (1 - c)"""


_ZERO = (0.0, 0.0, 0.0)
_ORIGIN = Pose(0.0, 0.0, 0.0)
STANDING = Travelled(0.0, 0.0)


def new_fix_correlation() -> FixCorrelation:
    """Return the memory before the first fix: independent errors."""
    return FixCorrelation(False, _ZERO, _ZERO, _ORIGIN, 0.0, 1.0, 0.0, 0.0, 0, 1.0)


def unpaired(fix_correlation: FixCorrelation) -> FixCorrelation:
    """Return the memory after a fix that was not accepted, or a jump of the estimate."""
    _, innovation, residual, estimate, var_theta, difference, motion, product, pairs, inflation = fix_correlation
    return FixCorrelation(
        False, innovation, residual, estimate, var_theta, difference, motion, product, pairs, inflation
    )


def shifted(fix_correlation: FixCorrelation, before: Pose, after: Pose) -> FixCorrelation:
    """Return the memory after fixes of another source have moved the estimate: it is no motion of the robot."""
    dx, dy, turn = after.x - before.x, after.y - before.y, wrap_angle(after.theta - before.theta)
    (x, y, theta), start = fix_correlation.residual, fix_correlation.estimate
    moved = Pose(start.x + dx, start.y + dy, wrap_angle(start.theta + turn))
    return fix_correlation._replace(residual=(x - dx, y - dy, theta - turn), estimate=moved)


def travel(travelled: Travelled, motion: Motion, var_lateral: float) -> Travelled:
    """Add a motion; ``var_lateral`` is its variance across the robot [m^2]."""
    along, turn = travelled
    covariance = covariance_with_rate(motion.covariance, gyro_share(motion.covariance, motion.rate))
    squared = motion.dt * motion.dt
    return Travelled(along + squared * covariance.var_v + var_lateral, turn + squared * covariance.var_omega)


def with_fix(
    fix_correlation: FixCorrelation,
    travelled: Travelled,
    fix: Pose,
    R: Variances,
    before: Pose,
    after: Pose,
    var_theta: float,
) -> FixCorrelation:
    """Update the memory with an accepted fix.

    Args:
        fix_correlation: the memory.
        travelled: since the fix before.
        fix: the measured pose.
        R: of its errors, as claimed.
        before: the estimate before its correction.
        after: the estimate after it.
        var_theta: of that estimate [rad^2].
    """
    paired, last, old, start, old_var_theta, difference, motion, product, pairs, inflation = fix_correlation
    (fix_x, fix_y, fix_theta), (x_before, y_before, theta_before) = fix, before
    x, y, theta = fix_x - x_before, fix_y - y_before, heading_innovation(fix_theta, theta_before)
    if paired:
        (last_x, last_y, last_theta), (old_x, old_y, old_theta) = last, old
        by_x, by_y, by_theta = 1.0 / R.x, 1.0 / R.y, 1.0 / R.theta
        size = 3 if by_theta > 0.0 else 2
        r_x, r_y, r_theta = x - old_x, y - old_y, theta - old_theta
        newest = (r_x * r_x * by_x + r_y * r_y * by_y + r_theta * r_theta * by_theta) * (0.5 / size)
        if newest < MAX_SQUARE:
            # An error of the heading turns what was driven: it moves the end across.
            dx, dy = x_before - start.x, y_before - start.y
            moved = 0.5 * (travelled.along + (dx * dx + dy * dy) * old_var_theta) * (by_x + by_y)
            both = (x * last_x * by_x + y * last_y * by_y + theta * last_theta * by_theta) / size
            if pairs < MEMORY:
                pairs += 1
            difference += (newest - difference) / pairs
            motion += ((moved + travelled.turn * by_theta) * (0.5 / size) - motion) / pairs
            product += (both - product) / pairs
            c = correlation_of(difference, motion, product, size * pairs)
            inflation = (1.0 + c) / (1.0 - c)
    residual = (fix_x - after.x, fix_y - after.y, theta - wrap_angle(after.theta - theta_before))
    return FixCorrelation(
        True, (x, y, theta), residual, after, var_theta, difference, motion, product, pairs, inflation
    )


def growth(before: FixCorrelation, after: FixCorrelation) -> float:
    """Factor on the pose's part of P after a fix: P was computed with too small an R if the inflation has grown."""
    return max(after.inflation / before.inflation, 1.0)


def correlation_of(difference: float, motion: float, product: float, products: int) -> float:
    """Return c from the means over so many ``products`` of two numbers, see :class:`FixCorrelation`."""
    # Odometry is often better than it claims: the motion explains half of the difference at most.
    motion = min(motion, 0.5 * difference)
    by_difference = 1.0 + motion - difference
    if by_difference <= 0.0 or product <= 0.0:
        return 0.0
    # White innovations have a product of mean 0; its deviation is their variance over the root of the number.
    variance = difference + product
    if product * product * products <= (_SIGNIFICANT * variance) ** 2:
        return 0.0
    by_product = product / (product + max(difference - motion, 1e-3))
    return min(by_difference, by_product, _MAX_CORRELATION)
