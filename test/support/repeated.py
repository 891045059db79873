"""How often a fault is tried: once in the normal suite, as often as promised in ``make slow``."""

from dataclasses import dataclass

import pytest

SLACK = 10.0
"""Factor on each bound in the normal suite, whose tests share the processors; ``make slow`` measures."""
TIMEOUT = 7200
"""[s] of a slow test"""


@dataclass(frozen=True)
class Trials:
    """The numbers of the trials of a test, and the factor on its bounds."""

    count: int
    slack: float

    def __iter__(self):
        """Return the numbers of the trials."""
        return iter(range(self.count))

    def bound(self, value, delay=0.0):
        """Return the largest allowed value; ``delay`` is what the scheduler may have added."""
        return self.slack * value + delay


def tried(full, once=1):
    """Give a test the parameter ``trials``: ``once`` in the normal suite, ``full`` trials in the slow one."""
    marks = (pytest.mark.slow, pytest.mark.timeout(TIMEOUT))
    slow = pytest.param(Trials(full, 1.0), id=f"{full} trials", marks=marks)
    return pytest.mark.parametrize("trials", [pytest.param(Trials(once, SLACK), id="once"), slow])
