"""Checks of covariances from messages and files, and the uncertainty that a covariance expresses.

An all-zero covariance means *unknown*, never *exact*: it is refused here, and the caller uses its fallback.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from diffbot_core.errors import BadMessageError
from diffbot_core.uncertainty import Uncertainty, largest_deviation

_ASYMMETRY = 1e-6
"""Relative difference of mirrored entries that rounding, e.g. to single precision, may cause."""
_MIN_PIVOT = 1e-14
"""[m^2], [rad^2] A conditional variance that is smaller is 0 but for rounding; inverting it may overflow."""
_MAX_VARIANCE = 1e8
"""[m^2], [rad^2] A larger number is an error or a code for 'unknown', not a variance."""
_SINGULAR = 1e-9
"""Relative size of a negative pivot that rounding may cause in a singular matrix."""


class UnknownCovarianceError(BadMessageError):
    """A covariance that is not wrong but unknown: all zero, a code for 'unknown', or without one of the numbers."""


def check_covariance(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a (n, n) covariance if it is finite, symmetric, positive definite and not absurdly large.

    Raises:
        UnknownCovarianceError: if it is zero, singular or absurdly large, so that the caller can use a fallback.
        BadMessageError: if it is not finite, not symmetric or indefinite; the error names the missing property.
    """
    # Plain floats: this runs for each message, and numpy is several times slower with matrices of this size.
    rows: list[list[float]] = matrix.tolist()
    # A NaN or Inf anywhere makes the sum NaN or Inf.
    if not math.isfinite(sum(map(sum, rows))):
        raise BadMessageError("covariance not finite")
    diagonal = [row[i] for i, row in enumerate(rows)]
    if not any(diagonal):
        raise UnknownCovarianceError("covariance is zero")
    largest = max(diagonal)
    if largest > _MAX_VARIANCE:
        raise UnknownCovarianceError("covariance too large", f"{largest:g} > {_MAX_VARIANCE:g}")
    allowed = _ASYMMETRY * abs(largest)
    for i, row in enumerate(rows):
        for j in range(i):
            if abs(row[j] - rows[j][i]) > allowed:
                raise BadMessageError("covariance not symmetric")
    pivot = _smallest_pivot(rows)
    if not pivot > _MIN_PIVOT:
        # A receiver that does not measure one of the numbers sends a singular matrix; an indefinite one is an error.
        kind = UnknownCovarianceError if pivot >= -_SINGULAR * largest else BadMessageError
        raise kind("covariance not positive definite")
    return matrix


def _smallest_pivot(rows: list[list[float]]) -> float:
    """Return the first pivot that is not positive, or the last one; the Cholesky factor overwrites the lower part."""
    for i, row in enumerate(rows):
        pivot = row[i]
        for j in range(i):
            other = rows[j]
            value = row[j]
            for k in range(j):
                value -= row[k] * other[k]
            row[j] = value = value / other[j]
            pivot -= value * value
        if not pivot > _MIN_PIVOT:
            return pivot
        row[i] = math.sqrt(pivot)
    return pivot


def uncertainty_of(P: NDArray[np.float64]) -> Uncertainty:
    """Return the standard deviations of an estimate with covariance ``P`` (3, 3) of x, y, theta [m, m, rad]."""
    (xx, xy, _), (_, yy, _), (_, _, tt) = P.tolist()
    return Uncertainty(largest_deviation(xx, xy, yy), math.sqrt(max(tt, 0.0)))
