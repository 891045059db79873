"""What becomes of a measurement that the filter did not expect: pure functions with their memory.

A gate alone locks a filter out for good once it is lost. So rejected fixes are not forgotten: they feed a second
hypothesis, a candidate that starts at a rejected fix and is moved by the same odometry. Outliers do not agree with
each other, but the fixes of a robot that was carried away or has slipped do; then the candidate takes over.
"""

from __future__ import annotations

from typing import NamedTuple

from diffbot_control.filter.options import FilterOptions

ACCEPTED, REJECTED, RELOCATED, IGNORED = 0, 1, 2, 3
_WIDENED, _TIGHTENED = 0.2, 0.05
"""Steps of the slack at a rejected and at an accepted fix: a gate that rejects more than a fifth is itself wrong."""


class FixGate(NamedTuple):
    """Fixes rejected in a row."""

    rejected: int = 0
    agreeing: int = 0
    """those of them that made the candidate, the newest included"""
    elapsed: float = 0.0
    """[s] since the first of them"""
    slack: float = 0.0
    """logarithm of the factor on the gate's bound"""


def passed(gate: FixGate, dt: float) -> FixGate:
    """Let ``dt`` [s] pass."""
    return FixGate(gate.rejected, gate.agreeing, gate.elapsed + dt, gate.slack) if gate.rejected > 0 else gate


def judged(gate: FixGate, expected: bool, agrees: bool, options: FilterOptions) -> tuple[FixGate, int]:
    """Decide on a fix.

    Args:
        gate: memory.
        expected: its NIS is within the gate.
        agrees: it is within the gate of the candidate, if there is one.
        options: see FilterConfig.

    Returns:
        Memory and ACCEPTED, REJECTED (correct the candidate if it agrees, else start one at the fix) or RELOCATED (the
        same, then the candidate takes over).
    """
    if expected:
        if gate.rejected == 0 and gate.slack == 0.0:
            return gate, ACCEPTED
        return FixGate(0, 0, 0.0, max(gate.slack - _TIGHTENED, 0.0)), ACCEPTED
    agreeing = gate.agreeing + 1 if agrees else 1
    slack = gate.slack + _WIDENED
    if agreeing >= options.relocation_fixes:
        # The gate was right to reject them: they were not noise.
        return FixGate(0, 0, 0.0, max(slack - agreeing * _WIDENED, 0.0)), RELOCATED
    if gate.rejected + 1 >= options.relocation_fixes and gate.elapsed >= options.relocation_timeout:
        return FixGate(0, 0, 0.0, slack), RELOCATED
    return FixGate(gate.rejected + 1, agreeing, gate.elapsed, slack), REJECTED


class Doubt(NamedTuple):
    """Headings and landmarks that were rejected while nothing was accepted."""

    rejected: int = 0
    elapsed: float = 0.0
    """[s] since the first of them"""


def doubted(doubt: Doubt, dt: float) -> Doubt:
    """Let ``dt`` [s] pass."""
    return Doubt(doubt.rejected, doubt.elapsed + dt) if doubt.rejected > 0 else doubt


def doubting(doubt: Doubt) -> Doubt:
    """Count one more."""
    return Doubt(doubt.rejected + 1, doubt.elapsed)


def despaired(doubt: Doubt, options: FilterOptions) -> bool:
    """Whether they are so many and for so long that the belief is wrong, and not they."""
    return doubt.rejected >= options.relocation_fixes and doubt.elapsed >= options.relocation_timeout
