"""Whether the stamps of a stream of messages advance, and how fast; free of ROS."""

from __future__ import annotations

from collections import deque
from statistics import median

from diffbot_core.units import S_PER_NS

RESTART_GAP = 10**9
"""[ns] a stamp further back than this belongs to time that began anew, a closer one to a message out of order"""
PERIODS = 10
"""periods whose median is that of the stream: single gaps say nothing of it"""


class StampWatch:
    """Follows the stamps of one stream: a message that repeats the newest stamp is no sign of life of its sender."""

    def __init__(self) -> None:
        """Start without a stamp."""
        self.newest: int | None = None
        """[ns]"""

    def advances(self, stamp: int) -> bool:
        """Take the stamp [ns] of the newest message; return True if it is later than all before, or the first one.

        Time that has begun anew, as of a simulation that was started again, advances from the second message on.
        """
        newest = self.newest
        if newest is None or stamp > newest:
            self.newest = stamp
            return True
        if newest - stamp > RESTART_GAP:
            self.newest = stamp
        return False

    def clear(self) -> None:
        """Forget the stamps."""
        self.newest = None


class PeriodWatch:
    """Finds the period of a stream of messages by their stamps."""

    def __init__(self) -> None:
        """Start without a stamp."""
        self._newest: int | None = None
        self._periods: deque[int] = deque(maxlen=PERIODS)

    def next(self, stamp: int) -> float | None:
        """Take a stamp [ns]; return the median of the newest PERIODS periods [s], None before there are so many."""
        if self._newest is not None and stamp > self._newest:
            self._periods.append(stamp - self._newest)
        self._newest = stamp
        return S_PER_NS * median(self._periods) if len(self._periods) == PERIODS else None
