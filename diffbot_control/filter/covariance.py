"""Covariances: checks of those received in messages, their inverse, and the uncertainty they stand for.

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
"""[m^2], [rad^2] A smaller conditional variance is rounded zero; inverting it may overflow."""
_MAX_VARIANCE = 1e8
"""[m^2], [rad^2] A larger number is an error or a code for 'unknown', not a variance to compute with."""
_NOT_POSITIVE = "covariance not positive definite"
_SINGULAR = 1e-9
"""Relative size of a negative pivot that rounding may cause in a singular matrix."""


class UnknownCovarianceError(BadMessageError):
    """A covariance that is no error but says nothing: all zero, a code for 'unknown', or of a missing number."""


def check_covariance(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a (n, n) covariance if it is finite, symmetric, positive definite and not absurdly large.

    Raises:
        UnknownCovarianceError: if it is zero, singular or absurdly large, so that a fallback may stand in.
        BadMessageError: naming the property that it lacks, if it is not finite, not symmetric or indefinite.
    """
    # Plain floats: this runs for each message, and numpy takes several times as long for matrices so small.
    check_rows(matrix.tolist())
    return matrix


def check_rows(rows: list[list[float]]) -> None:
    """Check a covariance given by its rows, which are overwritten, as :func:`check_covariance` does."""
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
        # A singular one lacks a number, as a receiver without a heading sends it; an indefinite one is an error.
        kind = UnknownCovarianceError if pivot >= -_SINGULAR * largest else BadMessageError
        raise kind(_NOT_POSITIVE)


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


def inverse(S: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the inverse of a covariance (m, m), m <= 3, by its factors L D L'; a third of the time of numpy's.

    Raises:
        LinAlgError: if it is not positive definite to working precision.
    """
    # Flat lists and one array: half of the time goes into the conversions. A smaller S is filled up by the identity.
    size = len(S)
    if size == 3:
        a, b, c, _, d, e, _, _, f = S.ravel().tolist()
    elif size == 2:
        (a, b, _, d), c, e, f = S.ravel().tolist(), 0.0, 0.0, 1.0
    else:
        a, b, c, d, e, f = S.item(), 0.0, 0.0, 1.0, 0.0, 1.0
    if a > 0.0:
        p, q = b / a, c / a
        second, t = d - p * b, e - q * b
        if second > 0.0:
            r = t / second
            third = f - q * c - r * t
            if third > 0.0:
                j, k, s = 1.0 / second, 1.0 / third, p * r - q
                yz, xz = -r * k, s * k
                xy = -p * j - r * xz
                found = np.array((1.0 / a + p * p * j + s * xz, xy, xz, xy, j - r * yz, yz, xz, yz, k)).reshape(3, 3)
                return found if size == 3 else found[:size, :size]
    raise np.linalg.LinAlgError(_NOT_POSITIVE)


def uncertainty_of(P: NDArray[np.float64]) -> Uncertainty:
    """Standard deviations of an estimate with covariance ``P`` (3, 3) of x, y, theta [m, m, rad]."""
    (xx, xy, _), (_, yy, _), (_, _, tt) = P.tolist()
    return Uncertainty(largest_deviation(xx, xy, yy), math.sqrt(max(tt, 0.0)))
