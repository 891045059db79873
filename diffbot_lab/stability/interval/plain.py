"""Interval arithmetic of the checker, in plain numpy: bounds are widened by SLACK, absolute and relative.

numpy's functions are within a few ulp (some 1e-15) and the checker's numbers are below 1e4 with few operations between
two widenings, so SLACK exceeds their errors by far.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Pair = tuple[Array, Array]
"""Lower and upper bounds."""

SLACK = 1e-11


def wide(low: Array, high: Array) -> Pair:
    """Round outward."""
    return low - SLACK * (1.0 + np.abs(low)), high + SLACK * (1.0 + np.abs(high))


def times(a: Pair, b: Pair) -> Pair:
    """Bounds of products."""
    products = [x * y for x in a for y in b]
    return wide(np.minimum.reduce(products), np.maximum.reduce(products))


def cosine(a: Pair) -> Pair:
    """Cosine on an interval within +-3 pi."""
    ends = np.cos(a[0]), np.cos(a[1])
    low, high = np.minimum(*ends), np.maximum(*ends)
    for turn in range(-3, 4):
        inside = (a[0] - SLACK <= turn * math.pi) & (turn * math.pi <= a[1] + SLACK)
        low, high = (np.where(inside, -1.0, low), high) if turn % 2 else (low, np.where(inside, 1.0, high))
    return wide(low, high)


def sinc(a: Pair) -> Pair:
    """sin(a)/a on an interval within +-4, where it falls with |a|."""
    near = np.where((a[0] <= 0.0) & (a[1] >= 0.0), 0.0, np.minimum(np.abs(a[0]), np.abs(a[1])))
    far = np.maximum(np.abs(a[0]), np.abs(a[1]))
    return wide(np.sinc(far / math.pi), np.sinc(near / math.pi))


def tanhc(r: Pair) -> Pair:
    """tanh(r)/r for r >= 0, where it falls; 1 at 0."""
    low, high = (np.where(one > 1e-7, np.tanh(one) / np.maximum(one, 1e-7), 1.0) for one in (r[1], r[0]))
    return wide(low, high)
