"""The time that a step may use for the limits of acceleration: never more than has passed since the last command."""

from __future__ import annotations

import math

_SLACK = 0.05
"""[s] by which stamps may run ahead of the time that has passed: the jitter of their arrival"""


class StepClock:
    """Limits the time between stamps by the steady clock, and after a halt to one period."""

    def __init__(self) -> None:
        """Start with the whole slack."""
        self._last = math.nan
        """[s] steady time of the last step"""
        self._credit = _SLACK
        """[s] that has passed and was not used, at most the slack"""
        self._period = 0.0
        """[s] the newest step"""
        self._is_halted = False

    def limited(self, dt: float, steady: float) -> float:
        """Return the time [s] of a step whose stamp is ``dt`` [s] after the last one's.

        Args:
            dt: [s] by the stamps.
            steady: [s] present time on the steady clock; nan if the stamps alone count.
        """
        if self._is_halted:
            # The robot was stopped meanwhile: it starts from rest, with one step.
            self._is_halted = False
            dt = min(dt, self._period)
        passed, self._last = steady - self._last, steady
        if not math.isnan(passed):
            allowed = max(passed, 0.0) + self._credit
            dt = min(dt, allowed)
            self._credit = min(allowed - dt, _SLACK)
        self._period = dt
        return dt

    def halt(self) -> None:
        """Note that the robot was stopped at once."""
        self._is_halted = True
