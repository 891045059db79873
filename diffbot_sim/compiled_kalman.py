"""The algebra of :mod:`diffbot_control.filter.kalman` as loops that numba compiles. A test compares both."""

from __future__ import annotations

from typing import Any

import numpy as np

from diffbot_control.filter import kalman


def propagate(P: Any, F: Any, Q: Any) -> Any:
    """Return F P F' + Q; all are (n, n). Zeros in F are skipped."""
    n = len(P)
    FP, result = np.zeros((n, n)), Q.copy()
    for i in range(n):
        for k in range(n):
            f = F[i, k]
            if f != 0.0:
                for j in range(n):
                    FP[i, j] += f * P[k, j]
    for j in range(n):
        for k in range(n):
            f = F[j, k]
            if f != 0.0:
                for i in range(n):
                    result[i, j] += f * FP[i, k]
    return result


def correct(P: Any, y: Any, H: Any, R: Any) -> Any:
    """Return the shift K y (n,) and the covariance P - K S K' (n, n), as kalman.correct does.

    With the Cholesky factor L of S and W = P H' L'^-1, the shift is W L^-1 y and the covariance is P - W W', which is
    symmetric.
    """
    m, n = H.shape
    L, u = innovation_covariance(P, H, R), y.copy()
    factorise(L, u)
    W, shift, corrected = product_of(P, H), np.zeros(n), P.copy()
    for i in range(n):
        for j in range(m):
            for k in range(j):
                W[i, j] -= L[j, k] * W[i, k]
            W[i, j] /= L[j, j]
            shift[i] += W[i, j] * u[j]
        for other in range(i + 1):
            for j in range(m):
                corrected[i, other] -= W[i, j] * W[other, j]
            corrected[other, i] = corrected[i, other]
    return shift, corrected


def product_of(P: Any, H: Any) -> Any:
    """Return P H' (n, m). Zeros in H are skipped."""
    m, n = H.shape
    PH = np.zeros((n, m))
    for j in range(m):
        for k in range(n):
            h = H[j, k]
            if h != 0.0:
                for i in range(n):
                    PH[i, j] += P[i, k] * h
    return PH


def factorise(S: Any, u: Any) -> None:
    """Replace a positive definite S (m, m) by its Cholesky factor L, and u (m,) by L^-1 u, in place."""
    m = len(u)
    for j in range(m):
        for k in range(j):
            S[j, j] -= S[j, k] * S[j, k]
            u[j] -= S[j, k] * u[k]
            for i in range(j + 1, m):
                S[i, j] -= S[i, k] * S[j, k]
        root = np.sqrt(S[j, j])
        u[j] /= root
        for i in range(j, m):
            S[i, j] /= root


def innovation_covariance(P: Any, H: Any, R: Any) -> Any:
    """Return H P H' + R (m, m). Zeros in H are skipped."""
    m, n = H.shape
    S = R.copy()
    for i in range(m):
        for k in range(n):
            h = H[i, k]
            if h != 0.0:
                for j in range(m):
                    for other in range(n):
                        S[i, j] += h * P[k, other] * H[j, other]
    return S


def condition(x: Any, P: Any, at: int, value: float) -> Any:
    """Return mean (n,) and covariance (n, n), as kalman.condition does."""
    n = len(x)
    mean, covariance = x.copy(), P.copy()
    for i in range(n):
        gain = P[i, at] / P[at, at]
        mean[i] += gain * (value - x[at])
        for j in range(n):
            covariance[i, j] -= gain * P[at, j]
    return mean, covariance


LOOPS = {
    kalman.propagate: propagate,
    kalman.condition: condition,
    kalman.correct: correct,
    kalman.innovation_covariance: innovation_covariance,
}
"""Replacements of the functions that use filterpy, for compiled code."""
