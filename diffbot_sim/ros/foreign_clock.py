"""Pace of a plant that takes its steps by the /clock of another one. Free of ROS."""

from __future__ import annotations

from diffbot_core.units import NS_PER_S, S_PER_NS
from diffbot_sim.ros.pacing import ClockPace

_MAX_STEPS_AT_ONCE = 1000
"""The other plant may take long steps: all of this one's that fall into one are due together."""


class ForeignClock:
    """Steps due by readings of a clock that another node sends."""

    def __init__(self, period: int) -> None:
        """Wait for the first reading; ``period`` [ns] is that of the steps."""
        self._period = period
        self._pace: ClockPace | None = None
        self._newest = self._origin = 0

    @property
    def skipped(self) -> int:
        """Steps left out because time jumped far ahead."""
        return 0 if self._pace is None else self._pace.skipped

    def on_clock(self, stamp: int) -> int | None:
        """Take the reading ``stamp`` [ns] and return how many steps are due, None if time begins (again) with it."""
        jumped_back = stamp < self._newest
        self._newest = stamp
        # Counted from here: seconds since 1970 leave a float only 0.2 us.
        if self._pace is None or jumped_back:
            self._origin = stamp
            self._pace = ClockPace(self._period * S_PER_NS, 0.0, _MAX_STEPS_AT_ONCE)
            return None
        return self._pace.due((stamp - self._origin) / NS_PER_S)

    def restart(self) -> None:
        """Begin again with the next reading, after a pause."""
        self._pace = None
