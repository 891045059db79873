"""Fewer rows with the same peaks: the smallest and the largest value of each column in each bucket of rows stay."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def kept_rows(columns: Array, max_rows: int) -> NDArray[np.int64]:
    """Return the rows to keep, in order: at most about ``max_rows``, all of them if they are no more.

    Args:
        columns: (n, k) values; rows with NaN count only by their other columns.
        max_rows: at least 4 k.
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
