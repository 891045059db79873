"""The clock of a replay: steady time in nanoseconds, and waiting for it. A test puts one of its own in its place."""

from __future__ import annotations

import threading
import time

from diffbot_bag.replay.playback_clock import SECOND

LONGEST_WAIT = 3600.0
"""[s] A gap in a bag may be longer than a lock can wait."""
SPIN = 100_000
"""[ns] before a deadline, the clock spins instead of sleeping, since a sleep ends about that late."""


class SteadyClock:
    """Steady time of this machine."""

    def now(self) -> int:
        """Return the time [ns], from an arbitrary origin."""
        return time.perf_counter_ns()

    def sleep_until(self, target: int) -> None:
        """Return at ``target`` [ns], or at once if it is over; late by a microsecond on a free processor."""
        remaining = target - self.now()
        if remaining > SPIN:
            time.sleep((remaining - SPIN) / SECOND)
        while self.now() < target:
            pass

    def wait(self, condition: threading.Condition, duration: int | None) -> None:
        """Wait until ``condition``, which the caller holds, is notified, at most ``duration`` [ns]; None: no limit."""
        condition.wait(None if duration is None else min(duration / SECOND, LONGEST_WAIT))
