"""Interval arithmetic with outward rounding, as functions of plain floats that numba compiles.

An interval is two arguments, its lower and its upper bound; each function returns the bounds of a set that contains
f(x) for every real x in its arguments. Arguments are finite, with the lower bound first and |x| < 1e150. The result of
``div``, ``sqrt`` and ``asin`` is infinite or NaN where there is no bound: check before it is used.

Why it is rigorous:

- Operations of IEEE 754 (+ - * / sqrt) are rounded to nearest, so the exact result is no farther than the next float.
  ``up`` and ``down`` move at least that far (Rump, Zimmermann, Boldo, Melquiond, *Computing predecessor and successor
  in rounding to nearest*, BIT 49, 2009).
- sin, cos, atan, asin, atan2 and tanh come from the C library. The manual of glibc ("Known maximum errors in math
  functions") states at most 2 ulp for them; SVML, which numba calls in vector loops where it is installed, is within 1,
  or 4 with numba's fastmath, which is never used here. Their values are widened by ``LIBRARY_ULPS`` = 4 ulp, one of
  which covers the rounding of the widening itself.
- A compiler may contract a product and a sum into one operation, which is rounded once instead of twice. It cannot do
  that across ``up`` and ``down``, and may not reorder: numba's fastmath stays off.

The tests hold every function, compiled, against the ball arithmetic of Arb on a million boxes.
"""

from __future__ import annotations

import math

Bounds = tuple[float, float]

_NEXT = 2.0**-53 * (1.0 + 2.0**-52)
"""Share of |x| whose sum with x is rounded to the next float or beyond."""
_TINY = 2.0**-1022
"""Added to it for results near 0: the smallest normal number, since arithmetic with subnormal ones is slow."""
LIBRARY_ULPS = 4.0
"""ulp by which values of library functions are widened"""
_LIBRARY = LIBRARY_ULPS * 2.0**-52

PI_LOW = math.pi
PI_HIGH = 3.1415926535897936
"""The floats next to pi; math.pi is below it."""
TWO_PI_LOW, TWO_PI_HIGH = 2.0 * PI_LOW, 2.0 * PI_HIGH
_PER_PI = 1.0 / math.pi
_SINC_MONOTONE = 4.49
"""sin(x)/x decreases in |x| up to its minimum at 4.4934..."""
_SINC_MIN, _SINC_MAX = -0.21723363, 0.1283746
"""Bounds of sin(x)/x beyond it: the minimum there, and the maximum at 7.7252..."""


def up(x: float) -> float:
    """Return a float above ``x``: the next one, or a few beyond it for |x| < 1e-290."""
    return x + (abs(x) * _NEXT + _TINY)


def down(x: float) -> float:
    """Return a float below ``x``; see :func:`up`."""
    return x - (abs(x) * _NEXT + _TINY)


def _above(y: float) -> float:
    """Upper bound of the exact value for which a library function returned ``y``."""
    return y + (abs(y) * _LIBRARY + _TINY)


def _below(y: float) -> float:
    return y - (abs(y) * _LIBRARY + _TINY)


def hull(a0: float, a1: float, b0: float, b1: float) -> Bounds:
    """Smallest interval that contains both."""
    return min(a0, b0), max(a1, b1)


def add(a0: float, a1: float, b0: float, b1: float) -> Bounds:
    """Return bounds of a + b."""
    return down(a0 + b0), up(a1 + b1)


def sub(a0: float, a1: float, b0: float, b1: float) -> Bounds:
    """Return bounds of a - b."""
    return down(a0 - b1), up(a1 - b0)


def mul(a0: float, a1: float, b0: float, b1: float) -> Bounds:
    """Return bounds of a b."""
    p, q, r, s = a0 * b0, a0 * b1, a1 * b0, a1 * b1
    return down(min(p, q, r, s)), up(max(p, q, r, s))


def div(a0: float, a1: float, b0: float, b1: float) -> Bounds:
    """Return bounds of a / b; infinite if b contains 0."""
    if not (b0 > 0.0 or b1 < 0.0):
        return -math.inf, math.inf
    p, q, r, s = a0 / b0, a0 / b1, a1 / b0, a1 / b1
    return down(min(p, q, r, s)), up(max(p, q, r, s))


def absolute(a0: float, a1: float) -> Bounds:
    """Return the exact interval of |a|."""
    return max(a0, -a1, 0.0), max(-a0, a1)


def sqr(a0: float, a1: float) -> Bounds:
    """Return bounds of a^2."""
    low, high = absolute(a0, a1)
    return max(down(low * low), 0.0), up(high * high)


def sqrt(a0: float, a1: float) -> Bounds:
    """Return bounds of the square root; what lies below 0 is left out, NaN if that is all."""
    if not a1 >= 0.0:
        return math.nan, math.nan
    return max(down(math.sqrt(max(a0, 0.0))), 0.0), up(math.sqrt(a1))


def hypot(a0: float, a1: float, b0: float, b1: float) -> Bounds:
    """Return bounds of sqrt(a^2 + b^2)."""
    p0, p1 = sqr(a0, a1)
    q0, q1 = sqr(b0, b1)
    s0, s1 = add(p0, p1, q0, q1)
    return sqrt(s0, s1)


def cos(a0: float, a1: float) -> Bounds:
    """Return bounds of the cosine, for an interval of any place and width."""
    return _cosine(math.cos(a0), math.cos(a1), _below(a0 * _PER_PI), _above(a1 * _PER_PI))


def sin(a0: float, a1: float) -> Bounds:
    """Return bounds of the sine, for an interval of any place and width."""
    turns0, turns1 = down(_below(a0 * _PER_PI) - 0.5), up(_above(a1 * _PER_PI) - 0.5)
    return _cosine(math.sin(a0), math.sin(a1), turns0, turns1)


def _cosine(at_low: float, at_high: float, turns0: float, turns1: float) -> Bounds:
    """Return bounds of cos(pi t), t in [turns0, turns1], from its values at the ends; t may be a little wider."""
    if not turns1 - turns0 < 2.0:
        return -1.0, 1.0
    low, high = _below(min(at_low, at_high)), _above(max(at_low, at_high))
    # Extremes are at the integers: 1 at the even ones, -1 at the odd ones. At most two lie inside.
    first = math.ceil(turns0)
    odd = first % 2 != 0
    if first <= turns1:
        low, high = (-1.0, high) if odd else (low, 1.0)
    if first + 1.0 <= turns1:
        low, high = (low, 1.0) if odd else (-1.0, high)
    return max(low, -1.0), min(high, 1.0)


def atan(a0: float, a1: float) -> Bounds:
    """Return bounds of the arc tangent."""
    return _below(math.atan(a0)), _above(math.atan(a1))


def asin(a0: float, a1: float) -> Bounds:
    """Return bounds of the arc sine; what lies outside of [-1, 1] is left out, NaN if that is all."""
    if not (a1 >= -1.0 and a0 <= 1.0):
        return math.nan, math.nan
    return _below(math.asin(max(a0, -1.0))), _above(math.asin(min(a1, 1.0)))


def tanh(a0: float, a1: float) -> Bounds:
    """Return bounds of the hyperbolic tangent."""
    return max(_below(math.tanh(a0)), -1.0), min(_above(math.tanh(a1)), 1.0)


def atan2(y0: float, y1: float, x0: float, x1: float) -> Bounds:
    """Return bounds of the direction of the points (x, y).

    The result is connected: a box that meets the cut, the negative half of the x axis, has directions around pi, in
    (0, 2 pi), any other box in [-pi, pi]. A box with the origin has all directions, (-PI_HIGH, PI_HIGH).
    """
    if y0 <= 0.0 <= y1 and x0 <= 0.0:
        if x1 >= 0.0:
            return -PI_HIGH, PI_HIGH
        low, high = _directions(-y1, -y0, -x1, -x0)
        return down(low + PI_LOW), up(high + PI_HIGH)
    return _directions(y0, y1, x0, x1)


def _directions(y0: float, y1: float, x0: float, x1: float) -> Bounds:
    """Directions of a box without the cut and the origin: the extremes are at corners."""
    p, q, r, s = math.atan2(y0, x0), math.atan2(y0, x1), math.atan2(y1, x0), math.atan2(y1, x1)
    return _below(min(p, q, r, s)), _above(max(p, q, r, s))


def wrapped(low: float, high: float, turn: int) -> Bounds:
    """Part of an interval of angles that is in [-pi, pi] after ``turn`` = -1, 0 or 1 full turns less; may be empty."""
    p = low - turn * (TWO_PI_HIGH if turn > 0 else TWO_PI_LOW)
    q = high - turn * (TWO_PI_LOW if turn > 0 else TWO_PI_HIGH)
    return max(down(p), -PI_HIGH), min(up(q), PI_HIGH)


def sinc(a0: float, a1: float) -> Bounds:
    """Return bounds of sin(a)/a, 1 at 0."""
    near, far = absolute(a0, a1)
    if near > _SINC_MONOTONE:
        return _SINC_MIN, _SINC_MAX
    high = min(up(_above(math.sin(near)) / near), 1.0) if near > 0.0 else 1.0
    if far > _SINC_MONOTONE:
        return _SINC_MIN, max(high, _SINC_MAX)
    return (down(_below(math.sin(far)) / far) if far > 0.0 else 1.0), high


def tanhc(a0: float, a1: float) -> Bounds:
    """Return bounds of tanh(a)/a, 1 at 0; it decreases in |a|."""
    near, far = absolute(a0, a1)
    high = min(up(_above(math.tanh(near)) / near), 1.0) if near > 0.0 else 1.0
    low = max(down(_below(math.tanh(far)) / far), 0.0) if far > 0.0 else 1.0
    return low, high
