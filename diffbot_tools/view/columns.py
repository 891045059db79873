"""Curves of the page: the columns of each curve, and how a curve is thinned."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Columns = dict[str, Array]
"""Columns of equal length (n,) by name, of which ``t`` [s] is the time."""

FILTER_COLUMNS = ("nis", "nis_low", "nis_high", "whiteness", "whiteness_bound", "left", "right")
"""Mean NIS per number and its 95 % bounds, autocorrelation of the first kind of measurement, wheel radius errors."""
COLUMNS: dict[str, tuple[str, ...]] = {
    "estimate": ("t", "x", "y", "theta", "xx", "xy", "yy", "tt", "xt", "yt"),
    "truth": ("t", "x", "y", "theta", "v", "omega", "tt"),
    "odometry": ("t", "x", "y", "theta", "v", "omega"),
    "fixes": ("t", "x", "y", "theta"),
    "residual": ("t", "x", "y", "theta"),
    "to_goal": ("t", "distance", "heading"),
    "command": ("t", "v", "omega"),
    "law": ("t", "rho", "alpha", "beta", "eps_P", "region", "V"),
    "filter": ("t", *FILTER_COLUMNS),
}
"""Columns of each curve, by its name; ``t`` is the time [s]."""


def kept_rows(columns: Array, max_rows: int) -> NDArray[np.int64]:
    """Return the indices of the rows to keep, in order: the lowest and the highest value of each column per bucket.

    Args:
        columns: (n, k) values; NaN is neither the lowest nor the highest value.
        max_rows: about the largest number of rows, at least 4 k; a table with fewer rows is kept whole.
    """
    n, k = columns.shape
    if n <= max_rows:
        return np.arange(n)
    buckets = max((max_rows - 2) // (2 * k), 1)
    width = -(-n // buckets)
    padded = np.full((buckets * width, k), np.nan)
    padded[:n] = columns
    blocks = padded.reshape(buckets, width, k)
    first = np.arange(buckets)[:, None] * width
    low = first + np.argmin(np.where(np.isnan(blocks), np.inf, blocks), axis=1)
    high = first + np.argmax(np.where(np.isnan(blocks), -np.inf, blocks), axis=1)
    kept: NDArray[np.int64] = np.unique(np.concatenate((low.ravel(), high.ravel(), [0, n - 1])))
    inside: NDArray[np.int64] = kept[kept < n]
    return inside
