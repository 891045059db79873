"""The number of trials of a fault: few in the normal suite, as many as promised in ``make slow``."""

from dataclasses import dataclass

import pytest

SLACK = 10.0
"""Factor on each bound in the normal suite, whose tests share the processors. ``make slow`` measures."""
TIMEOUT = 7200
"""[s] of a slow test"""


@dataclass(frozen=True)
class Trials:
    """The numbers of the trials, from 0, and the factor on the bounds of the test."""

    count: int
    slack: float

    def __iter__(self):
        return iter(range(self.count))

    def bound(self, value, delay=0.0):
        """Return the largest allowed value; ``delay`` is the time that the scheduler may have added."""
        return self.slack * value + delay


def tried(full, once=1):
    """Give a test the parameter ``trials``: ``once`` in the normal suite (0: left out), ``full`` in ``make slow``."""
    marks = (pytest.mark.slow, pytest.mark.timeout(TIMEOUT))
    trials = [pytest.param(Trials(full, 1.0), id=f"{full} trials", marks=marks)]
    if once:
        trials.insert(0, pytest.param(Trials(once, SLACK), id="once"))
    return pytest.mark.parametrize("trials", trials)
