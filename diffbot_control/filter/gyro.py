"""Turn rates of a gyro, kept until the odometry steps in which they were measured can no longer change."""

from __future__ import annotations

import math
from bisect import bisect_right
from operator import attrgetter
from typing import NamedTuple

from diffbot_control.filter.models import NO_RATE, TurnRate
from diffbot_core.errors import BadMessageError

_MAX_WAITING = 10_000
"""Samples that may wait for their odometry; if there are more, no odometry comes."""
_stamp_of = attrgetter("stamp")


class GyroSample(NamedTuple):
    """Turn rate at a time, with an error independent from sample to sample."""

    stamp: int
    """[ns]"""
    rate: float
    """[rad/s]"""
    variance: float
    """[rad^2/s^2]"""


class GyroHistory:
    """The newest samples in the order of their stamps."""

    def __init__(self) -> None:
        """Start empty."""
        self._samples: list[GyroSample] = []

    def clear(self) -> None:
        """Forget all samples."""
        self._samples.clear()

    def check(self, sample: GyroSample, now: int) -> None:
        """Refuse a sample that cannot be used.

        Args:
            sample: a new one.
            now: [ns] stamp of the newest odometry.

        Raises:
            BadMessageError: if it is not finite or a duplicate, or if too many wait for their odometry already.
        """
        if not math.isfinite(sample.rate + sample.variance):
            raise BadMessageError("measurement not finite")
        at = self._after(sample.stamp)
        if at > 0 and self._samples[at - 1].stamp == sample.stamp:
            raise BadMessageError("duplicate")
        if sample.stamp > now and len(self._samples) - self._after(now) >= _MAX_WAITING:
            raise BadMessageError("no odometry for it", f"{_MAX_WAITING} samples wait already")

    def add(self, sample: GyroSample) -> None:
        """Add a sample at its place."""
        self._samples.insert(self._after(sample.stamp), sample)

    def mean(self, start: int, end: int) -> TurnRate:
        """Return the mean of the samples in (``start``, ``end``] [ns]; NO_RATE without any."""
        found = self._samples[self._after(start) : self._after(end)]
        if not found:
            return NO_RATE
        n = len(found)
        return TurnRate(sum(one.rate for one in found) / n, sum(one.variance for one in found) / (n * n))

    def forget_until(self, stamp: int) -> None:
        """Forget the samples up to ``stamp`` [ns]."""
        if self._samples and self._samples[0].stamp <= stamp:
            del self._samples[: self._after(stamp)]

    def _after(self, stamp: int) -> int:
        """Return the place of the first sample after ``stamp``."""
        return bisect_right(self._samples, stamp, key=_stamp_of)
