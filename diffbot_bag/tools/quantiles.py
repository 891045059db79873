"""Quantiles of any number of values from bounded storage."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

ACCURACY = 2e-3
"""largest relative error of a quantile"""
_LOG_GAMMA = math.log1p(ACCURACY)
"""of gamma, the ratio of a bucket's ends"""


class Quantiles:
    """Counts and sums of whole numbers in buckets that grow geometrically.

    Bucket k > 0 holds the values in (gamma^(k-2), gamma^(k-1)], and their mean is within ACCURACY of each of them; the
    negative values have buckets of their own, 0 is exact. 64-bit numbers fill at most 44,000 buckets, whatever their
    number. Source: Masson, Rim, Lee, "DDSketch", VLDB 2019, there with the middle of the bucket for the mean.
    """

    def __init__(self) -> None:
        """Start without values."""
        self._counts: dict[int, int] = {}
        self._sums: dict[int, float] = {}
        self.count = 0
        self.smallest, self.largest = math.inf, -math.inf
        """exact; infinite without a value"""

    def add(self, values: NDArray[np.int64]) -> None:
        """Count values (n,)."""
        if not len(values):
            return
        self.count += len(values)
        self.smallest = min(self.smallest, int(values.min()))
        self.largest = max(self.largest, int(values.max()))
        numbers = values.astype(np.float64)
        # The logarithm of 1 is 0, but bucket 0 is that of the zeros.
        places = (1.0 + np.ceil(np.log(np.maximum(np.abs(numbers), 1.0)) / _LOG_GAMMA)) * np.sign(numbers)
        buckets, inverse = np.unique(places.astype(np.int64), return_inverse=True)
        counts, sums = np.bincount(inverse), np.bincount(inverse, numbers)
        for bucket, count, total in zip(buckets.tolist(), counts.tolist(), sums.tolist(), strict=True):
            self._counts[bucket] = self._counts.get(bucket, 0) + count
            self._sums[bucket] = self._sums.get(bucket, 0.0) + total

    def quantile(self, share: float) -> float:
        """Return the smallest value that at least ``share`` of all do not exceed, within ACCURACY; nan without values.

        Args:
            share: 0 to 1; 0.5 for the median.
        """
        rank, below = max(math.ceil(share * self.count), 1), 0
        for bucket in sorted(self._counts):
            below += self._counts[bucket]
            if below >= rank:
                mean = self._sums[bucket] / self._counts[bucket]
                return float(min(max(mean, self.smallest), self.largest))
        return math.nan
