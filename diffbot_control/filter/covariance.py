"""Checks of covariances from messages and files, and the uncertainty of an estimate with a covariance.

An all-zero covariance means *unknown*, never *exact*. It is refused here, and the caller uses its fallback.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from diffbot_core.errors import BadMessageError
from diffbot_core.uncertainty import Uncertainty, largest_deviation

_ASYMMETRY = 1e-6
"""Largest relative difference of mirrored entries; rounding to single precision causes a smaller difference."""
_MIN_PIVOT = 1e-14
"""[m^2], [rad^2] smallest conditional variance; a smaller one may be a rounding error of 0"""
_MAX_VARIANCE = 1e8
"""[m^2], [rad^2] largest variance; a larger number is an error or a code for 'unknown'"""
_SINGULAR = 1e-9
"""Largest size of a negative pivot, relative to the largest variance, that rounding causes in a singular matrix."""


class UnknownCovarianceError(BadMessageError):
    """The covariance is unknown: it is zero, singular or contains a code for 'unknown'."""


def check_covariance(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a (n, n) covariance if it is finite, symmetric, positive definite and not absurdly large.

    Raises:
        UnknownCovarianceError: if it is zero, singular or absurdly large; the caller can use a fallback.
        BadMessageError: if it is not finite, not symmetric or indefinite.
    """
    # Plain floats, since numpy is several times slower for matrices of this size, and this runs for each message.
    rows: list[list[float]] = matrix.tolist()
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
        # A sensor that does not measure all numbers sends a singular matrix. An indefinite matrix is an error.
        kind = UnknownCovarianceError if pivot >= -_SINGULAR * largest else BadMessageError
        raise kind("covariance not positive definite")
    return matrix


def _smallest_pivot(rows: list[list[float]]) -> float:
    """Return the first pivot of the Cholesky factorisation that is not positive, or the last pivot.

    The factor overwrites the lower part of ``rows``.
    """
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
    """Return the standard deviations of a pose with covariance ``P`` (3, 3) [m, m, rad]."""
    (xx, xy, _), (_, yy, _), (_, _, tt) = P.tolist()
    return Uncertainty(largest_deviation(xx, xy, yy), math.sqrt(max(tt, 0.0)))
