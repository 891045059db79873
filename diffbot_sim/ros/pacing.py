"""When the plant takes its next step by a clock; without a clock see :mod:`diffbot_sim.lockstep`. Free of ROS."""

from __future__ import annotations

import math

WALL, SCALED, LOCKSTEP = "wall", "scaled", "lockstep"
CLOCKS = (WALL, SCALED, LOCKSTEP)

_MAX_CATCH_UP = 5
_EARLY = 0.1
"""Share of the period by which a timer may fire early: it jitters, and a postponed step would come with the next."""


class ClockPace:
    """Steps due by a steady clock; a late caller catches up a few steps at a time, a very late one skips the rest."""

    def __init__(self, period: float, now: float, max_catch_up: int = _MAX_CATCH_UP, skips: bool = True) -> None:
        """Begin at ``now`` [s]; a step is due each ``period`` [s] of the clock, at most ``max_catch_up`` at a time.

        Without ``skips`` the steps beyond that stay due, as they must where each has the time of day.
        """
        self.period = period
        self._skips = skips
        self._max_catch_up = max_catch_up
        self.skipped = 0
        """steps left out because a call came too late"""
        self._next = now + period

    def restart(self, now: float) -> None:
        """Begin again at ``now`` [s], after a pause."""
        self._next = now + self.period

    def due(self, now: float) -> int:
        """Return how many steps to take at ``now`` [s]."""
        count = math.floor((now - self._next) / self.period + _EARLY) + 1
        if count < 1:
            return 0
        if not self._skips:
            count = min(count, self._max_catch_up)
        self._next += count * self.period
        if count > self._max_catch_up:
            self.skipped += count - self._max_catch_up
            return self._max_catch_up
        return count
