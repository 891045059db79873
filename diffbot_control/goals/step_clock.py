"""The time that a step may use for the limits of acceleration: never more than has passed since the last command."""

from __future__ import annotations

import math

_SLACK = 0.05
"""[s] by which stamps may run ahead of the time that has passed: the jitter of their arrival"""


class StepClock:
    """Limits the time between stamps by the steady clock; after a halt robot and time start anew."""

    def __init__(self) -> None:
        """Start with the whole slack."""
        self._last = math.nan
        """[s] steady time of the last step"""
        self._credit = _SLACK
        """[s] that has passed and was not used, at most the slack"""
        self._is_halted = False

    def limited(self, dt: float, steady: float) -> float:
        """Return the time [s] of a step whose stamp is ``dt`` [s] after the last one's.

        Args:
            dt: [s] by the stamps.
            steady: [s] present time on the steady clock; nan if the stamps alone count.
        """
        passed, self._last = steady - self._last, steady
        if self._is_halted:
            # Zero was sent meanwhile, and nobody knows when: no time has passed since.
            self._is_halted, self._credit = False, 0.0
            return 0.0
        if not math.isnan(passed):
            allowed = max(passed, 0.0) + self._credit
            dt = min(dt, allowed)
            self._credit = min(allowed - dt, _SLACK)
        return dt

    def halt(self) -> None:
        """Note that the robot was stopped at once."""
        self._is_halted = True
