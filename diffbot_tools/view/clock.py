"""Times and columns of the page."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from diffbot_core.units import S_PER_NS

Array = NDArray[np.float64]
Columns = dict[str, Array]
"""Columns of equal length (n,) by name, of which ``t`` [s] is the time."""


class Clock(NamedTuple):
    """Times of the page: seconds since the first stamp of the bag."""

    origin: int
    """[ns] first stamp"""
    offset: int
    """[ns] log time minus stamp, if both are of different clocks; else 0"""

    def of_stamps(self, stamps: NDArray[np.int64]) -> Array:
        """Return times [s] of stamps [ns]."""
        return np.asarray((stamps - self.origin) * S_PER_NS, float)

    def stamps_of(self, times: Array) -> NDArray[np.int64]:
        """Return stamps [ns] of times [s]: the inverse of :meth:`of_stamps`, to a microsecond for days."""
        return self.origin + np.round(times / S_PER_NS).astype(np.int64)

    def of_log_time(self, log_time: int) -> float:
        """Return the time [s] of a log time [ns]."""
        return (log_time - self.offset - self.origin) * S_PER_NS
