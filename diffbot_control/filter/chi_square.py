"""Bounds of the chi-square distribution, by its closed forms: scipy.special takes longer to import than ROS itself."""

from __future__ import annotations

import math
from functools import lru_cache

_STEPS = 200
"""Upper limit; six are usual."""
_TOLERANCE = 1e-12
"""Relative, of the last step; its error is about the square of that."""


def survival(x: float, dof: int) -> float:
    """Return the probability that a chi-square number of ``dof`` degrees of freedom exceeds ``x`` >= 0.

    Abramowitz and Stegun, Handbook of Mathematical Functions, 26.4.4 (odd ``dof``) and 26.4.5 (even ``dof``).
    """
    half = 0.5 * x
    if dof % 2:
        total, term, k = math.erfc(math.sqrt(half)), math.exp(-half) * math.sqrt(half / math.pi) * 2.0, 1.5
    else:
        total, term, k = 0.0, math.exp(-half), 1.0
    for _ in range(dof // 2):
        total += term
        term *= half / k
        k += 1.0
    return total


@lru_cache(maxsize=1024)
def chi_square_bound(dof: int, tail: float) -> float:
    """Return what a chi-square number of ``dof`` >= 1 degrees of freedom exceeds with probability ``tail``.

    Args:
        dof: degrees of freedom.
        tail: greater than 0, less than 1.
    """
    low, high = 0.0, float(dof)
    while survival(high, dof) > tail:
        low, high = high, 2.0 * high
    x = 0.5 * (low + high)
    for _ in range(_STEPS):
        found = survival(x, dof)
        low, high = (x, high) if found > tail else (low, x)
        density = math.exp((0.5 * dof - 1.0) * math.log(0.5 * x) - 0.5 * x - math.lgamma(0.5 * dof)) / 2.0
        # Newton's step on the logarithm, which is nearly straight in the tail; bisection where that leaves the bracket.
        step = x + found / density * math.log(found / tail) if found > 0.0 and density > 0.0 else math.nan
        step = step if low <= step <= high else 0.5 * (low + high)
        if abs(step - x) <= _TOLERANCE * x:
            return step
        x = step
    return x
