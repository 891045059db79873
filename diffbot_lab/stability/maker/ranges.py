"""Interval arithmetic of the maker, as functions of plain floats that numba compiles.

An interval is two arguments, its lower and its upper bound; each function returns the bounds of the values on it. They
are rounded to nearest: a certificate is only as good as its check, which has formulas and a rounding of its own, and
the maker widens each image by more than any rounding (``PADDING``). The result of ``div``, ``sqrt`` and ``asin`` is
infinite or NaN where there is no bound: check before it is used.
"""

from __future__ import annotations

import math

Bounds = tuple[float, float]

_SINC_MONOTONE = 4.49
"""sin(x)/x decreases in |x| up to its minimum at 4.4934..."""
_SINC_MIN, _SINC_MAX = -0.21723363, 0.1283746
"""Bounds of sin(x)/x beyond it: the minimum there, and the maximum at 7.7252..."""


def add(a0: float, a1: float, b0: float, b1: float) -> Bounds:
    """Return bounds of a + b."""
    return a0 + b0, a1 + b1


def sub(a0: float, a1: float, b0: float, b1: float) -> Bounds:
    """Return bounds of a - b."""
    return a0 - b1, a1 - b0


def mul(a0: float, a1: float, b0: float, b1: float) -> Bounds:
    """Return bounds of a b."""
    p, q, r, s = a0 * b0, a0 * b1, a1 * b0, a1 * b1
    return min(p, q, r, s), max(p, q, r, s)


def div(a0: float, a1: float, b0: float, b1: float) -> Bounds:
    """Return bounds of a / b; infinite if b contains 0."""
    if not (b0 > 0.0 or b1 < 0.0):
        return -math.inf, math.inf
    p, q, r, s = a0 / b0, a0 / b1, a1 / b0, a1 / b1
    return min(p, q, r, s), max(p, q, r, s)


def absolute(a0: float, a1: float) -> Bounds:
    """Return bounds of |a|."""
    return max(a0, -a1, 0.0), max(-a0, a1)


def sqr(a0: float, a1: float) -> Bounds:
    """Return bounds of a^2."""
    low, high = absolute(a0, a1)
    return low * low, high * high


def sqrt(a0: float, a1: float) -> Bounds:
    """Return bounds of the square root; what lies below 0 is left out, NaN if that is all."""
    if not a1 >= 0.0:
        return math.nan, math.nan
    return math.sqrt(max(a0, 0.0)), math.sqrt(a1)


def cos(a0: float, a1: float) -> Bounds:
    """Return bounds of the cosine, for an interval of any place and width."""
    return _cosine(math.cos(a0), math.cos(a1), a0 / math.pi, a1 / math.pi)


def sin(a0: float, a1: float) -> Bounds:
    """Return bounds of the sine, for an interval of any place and width."""
    return _cosine(math.sin(a0), math.sin(a1), a0 / math.pi - 0.5, a1 / math.pi - 0.5)


def _cosine(at_low: float, at_high: float, turns0: float, turns1: float) -> Bounds:
    """Return bounds of cos(pi t), t in [turns0, turns1], from its values at the ends."""
    if not turns1 - turns0 < 2.0:
        return -1.0, 1.0
    low, high = min(at_low, at_high), max(at_low, at_high)
    # Extremes are at the integers: 1 at the even ones, -1 at the odd ones. At most two lie inside.
    first = math.ceil(turns0)
    odd = first % 2 != 0
    if first <= turns1:
        low, high = (-1.0, high) if odd else (low, 1.0)
    if first + 1.0 <= turns1:
        low, high = (low, 1.0) if odd else (-1.0, high)
    return low, high


def asin(a0: float, a1: float) -> Bounds:
    """Return bounds of the arc sine; what lies outside of [-1, 1] is left out, NaN if that is all."""
    if not (a1 >= -1.0 and a0 <= 1.0):
        return math.nan, math.nan
    return math.asin(max(a0, -1.0)), math.asin(min(a1, 1.0))


def atan2(y0: float, y1: float, x0: float, x1: float) -> Bounds:
    """Return bounds of the direction of the points (x, y).

    The result is connected: a box that meets the cut, the negative half of the x axis, has directions around pi, in
    (0, 2 pi), any other box in [-pi, pi]. A box with the origin has all directions.
    """
    if y0 <= 0.0 <= y1 and x0 <= 0.0:
        if x1 >= 0.0:
            return -math.pi, math.pi
        low, high = _directions(-y1, -y0, -x1, -x0)
        return low + math.pi, high + math.pi
    return _directions(y0, y1, x0, x1)


def _directions(y0: float, y1: float, x0: float, x1: float) -> Bounds:
    """Directions of a box without the cut and the origin: the extremes are at corners."""
    p, q, r, s = math.atan2(y0, x0), math.atan2(y0, x1), math.atan2(y1, x0), math.atan2(y1, x1)
    return min(p, q, r, s), max(p, q, r, s)


def wrapped(low: float, high: float, turn: int) -> Bounds:
    """Part of an interval of angles that is in [-pi, pi] after ``turn`` = -1, 0 or 1 full turns less; may be empty."""
    return max(low - turn * math.tau, -math.pi), min(high - turn * math.tau, math.pi)


def sinc(a0: float, a1: float) -> Bounds:
    """Return bounds of sin(a)/a, 1 at 0."""
    near, far = absolute(a0, a1)
    if near > _SINC_MONOTONE:
        return _SINC_MIN, _SINC_MAX
    high = math.sin(near) / near if near > 0.0 else 1.0
    if far > _SINC_MONOTONE:
        return _SINC_MIN, max(high, _SINC_MAX)
    return (math.sin(far) / far if far > 0.0 else 1.0), high
