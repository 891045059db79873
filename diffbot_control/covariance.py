"""Covariances from outside: are they what they claim to be?"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from diffbot_control.errors import BadMessageError

_ASYMMETRY = 1e-6
"""Relative difference of mirrored entries that rounding on the way may cause."""
_LARGEST = 1e8
"""[m^2], [rad^2] above this a number is a slip or a code for 'unknown', not a variance to compute with."""


def check_covariance(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a (n, n) covariance if it is finite, symmetric, positive definite and not absurdly large.

    Raises:
        BadMessageError: saying what it is instead.
    """
    # Sums first: one NaN or Inf anywhere shows in them, and this runs for each message.
    if not math.isfinite(float(matrix.sum())):
        raise BadMessageError("covariance not finite")
    diagonal = matrix.diagonal()
    if not diagonal.any():
        raise BadMessageError("covariance is zero")
    if float(diagonal.max()) > _LARGEST:
        raise BadMessageError("covariance too large", f"{float(diagonal.max()):g} > {_LARGEST:g}")
    if float(np.abs(matrix - matrix.T).max()) > _ASYMMETRY * float(diagonal.max()):
        raise BadMessageError("covariance not symmetric")
    try:
        np.linalg.cholesky(matrix)
    except np.linalg.LinAlgError:
        raise BadMessageError("covariance not positive definite") from None
    return matrix
