"""Consistency of the filter, judged by the innovations of each source.

If the model is right, the innovations are white and their mean NIS is 1 per scalar. The mean NIS does not show
time-correlated errors, which make a filter overconfident if it assumes independent errors. The autocorrelation of the
innovations shows them.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

from diffbot_control.filter import noise
from diffbot_control.filter.models import Array

_FALSE_ALARM = 1e-4
"""Probability that the mean NIS of a consistent filter exceeds the alarm bound."""
_MIN_PAIRS = 30
"""Smallest number of pairs from which an autocorrelation is computed."""
_SIGMAS_95, _SIGMAS_ALARM = 1.96, 4.0
"""Bounds of an autocorrelation in standard deviations. White innovations at 5 Hz exceed the alarm bound at any time
within 15 minutes with a probability of 0.5 %."""
_STEPS = 200
"""Largest number of Newton steps to a quantile; six are usual."""
_TOLERANCE = 1e-12
"""Relative size of the last Newton step; the relative error is about its square."""


class SourceConsistency(NamedTuple):
    """Statistics of the newest accepted innovations of a source."""

    nis: float
    """mean NIS per scalar; 1 if the covariances are right"""
    numbers: int
    """number of scalars in the mean"""
    low: float
    """95 % of the means of a consistent filter are between ``low`` and ``high``"""
    high: float
    alarm: float
    """if the mean is above this bound, the covariances are too small for the innovations"""
    autocorrelation: float | None
    """autocorrelation of neighbouring innovations; 0 on average if they are white; None: there are too few pairs"""
    bound: float
    """95 % of the absolute autocorrelations of a consistent filter are below this bound"""
    assumed: float
    """correlation of neighbouring errors that the filter assumes"""
    scale: tuple[float, float]
    """factors on the claimed variances of positions and of angles that the filter uses"""

    @property
    def is_correlated(self) -> bool:
        """True if the innovations are significantly more correlated than the filter assumes the errors to be.

        If the filter does not follow the errors, the innovations have the same autocorrelation as the errors. If it
        does, their autocorrelation is smaller.
        """
        alarm = _SIGMAS_ALARM / _SIGMAS_95 * self.bound
        return self.autocorrelation is not None and self.autocorrelation > self.assumed + alarm


def survival(x: float, dof: int) -> float:
    """Return the probability that a chi-square variable with ``dof`` degrees of freedom exceeds ``x`` >= 0.

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
    """Return the bound that a chi-square variable with ``dof`` degrees of freedom exceeds with probability ``tail``."""
    low, high = 0.0, float(dof)
    while survival(high, dof) > tail:
        low, high = high, 2.0 * high
    x = 0.5 * (low + high)
    for _ in range(_STEPS):
        probability = survival(x, dof)
        low, high = (x, high) if probability > tail else (low, x)
        density = math.exp((0.5 * dof - 1.0) * math.log(0.5 * x) - 0.5 * x - math.lgamma(0.5 * dof)) / 2.0
        # Newton step on the logarithm, which is nearly linear in the tail; bisection if the step leaves the bracket.
        newton = math.nan
        if probability > 0.0 and density > 0.0:
            newton = x + probability / density * math.log(probability / tail)
        last, x = x, newton if low <= newton <= high else 0.5 * (low + high)
        if abs(x - last) <= _TOLERANCE * last:
            break
    return x


def nis_bounds(numbers: int) -> tuple[float, float, float]:
    """Return the lower, the upper and the alarm bound of a mean NIS over ``numbers`` scalars."""
    low, high, alarm = (chi_square_bound(numbers, tail) / numbers for tail in (0.975, 0.025, _FALSE_ALARM))
    return low, high, alarm


def consistency_of(row: Array, time: float) -> SourceConsistency | None:
    """Return the statistics of a source; None if no measurement was accepted yet.

    Args:
        row: row of the source, see :mod:`noise`.
        time: known correlation time of the errors [s]; 0: use the estimated correlation time.
    """
    numbers, pairs = int(row[noise.NIS_NUMBERS]), int(row[noise.WHITENESS_NUMBERS])
    if numbers == 0:
        return None
    nis = float(row[noise.NIS])
    return SourceConsistency(
        nis,
        numbers,
        *nis_bounds(numbers),
        float(row[noise.WHITENESS]) / nis if pairs >= _MIN_PAIRS and nis > 0.0 else None,
        _SIGMAS_95 / math.sqrt(max(pairs, 1)),
        noise.assumed_correlation(row, time),
        (noise.scale_of(row, False), noise.scale_of(row, True)),
    )
