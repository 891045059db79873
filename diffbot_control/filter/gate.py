"""The gate: what becomes of a measurement whose innovation is larger than the filter expects.

A gate alone would lock out a filter whose estimate has diverged. So rejected fixes are kept: they feed a second
hypothesis, the candidate, which starts at a rejected fix and is moved by the same odometry. Outliers do not agree with
each other, but the fixes of a robot that was carried away or has slipped do; then the candidate replaces the estimate.
Measurements that know no position, as headings and landmarks, give no candidate; if only they are rejected for long
enough, the pose is reset.

Pure functions with their memory. Each filter corrects, calls :func:`decide_fix` or :func:`decide_other`, and applies
the decision.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from diffbot_control.filter.options import FilterOptions

ACCEPTED, REJECTED, RELOCATED, IGNORED, WEIGHED = 0, 1, 2, 3, 4
RESET_VAR_XY, RESET_VAR_THETA = 25.0, 1.0
"""[m^2], [rad^2] variances of a pose that was contradicted for too long by measurements without a position"""
_SLACK_UP, _SLACK_DOWN = 0.2, 0.05
"""Change of the slack at a rejected and at an accepted fix: a gate that rejects more than a fifth is itself wrong."""


class RejectionStreak(NamedTuple):
    """Measurements rejected while none was accepted."""

    rejected: int
    elapsed: float
    """[s] since the first of them"""


class GateMemory(NamedTuple):
    """Memory of the gate."""

    fixes: RejectionStreak
    agreeing: int
    """rejected fixes that agree with the candidate, up to and including the newest"""
    slack: float
    """logarithm of the factor on the bound for fixes"""
    others: RejectionStreak
    """measurements that are no fixes; also ended by a fix that is accepted or relocates"""


class Decision(NamedTuple):
    """What to do with a measurement."""

    outcome: int
    """ACCEPTED: correct the estimate with it. REJECTED: keep the estimate. RELOCATED: of a fix, the candidate replaces
    the estimate; of others, reset the pose and correct it with the measurement. IGNORED: do nothing. WEIGHED: correct
    the estimate with a part of the gain."""
    agrees: bool
    """of a fix that is not accepted: correct the candidate with it; if False, start a new candidate at the fix"""


_NO_STREAK = RejectionStreak(0, 0.0)
_ACCEPT = Decision(ACCEPTED, False)


def new_gate() -> GateMemory:
    """Return the memory of a gate that has rejected nothing."""
    return GateMemory(_NO_STREAK, 0, 0.0, _NO_STREAK)


def age(memory: GateMemory, dt: float) -> GateMemory:
    """Advance the gate's memory by ``dt`` [s]; time counts during a rejection streak only."""
    fixes, agreeing, slack, others = memory
    if fixes.rejected == 0 and others.rejected == 0:
        return memory
    return GateMemory(_age_streak(fixes, dt), agreeing, slack, _age_streak(others, dt))


def _age_streak(streak: RejectionStreak, dt: float) -> RejectionStreak:
    return RejectionStreak(streak.rejected, streak.elapsed + dt) if streak.rejected > 0 else streak


def count_rejection(streak: RejectionStreak) -> RejectionStreak:
    """Add a rejection to a streak."""
    return RejectionStreak(streak.rejected + 1, streak.elapsed)


def diverged(streak: RejectionStreak, options: FilterOptions) -> bool:
    """True if rejections persist long enough to declare the estimate diverged."""
    return streak.rejected >= options.relocation_fixes and streak.elapsed >= options.relocation_timeout


def is_expected(nis: float, bound: float) -> bool:
    """True if the normalised innovation squared of a measurement is within the gate; False for nan."""
    return 0.0 <= nis <= bound


def fix_bound(memory: GateMemory, bound: float) -> float:
    """Return the bound for a fix, which is wider after many rejections."""
    return math.exp(memory.slack) * bound if memory.slack > 0.0 else bound


def decide_weight(memory: GateMemory, nis: float, bound: float) -> tuple[GateMemory, Decision]:
    """Decide on a measurement that is weighed beyond the gate and never rejected; see :func:`decide_other`."""
    if nis == math.inf:
        return memory, Decision(IGNORED, False)
    if math.isnan(nis):
        return memory, Decision(REJECTED, False)
    cleared = GateMemory(memory.fixes, memory.agreeing, memory.slack, _NO_STREAK)
    return cleared, _ACCEPT if is_expected(nis, bound) else Decision(WEIGHED, False)


def decide_fix(
    memory: GateMemory, nis: float, candidate_nis: float, bound: float, options: FilterOptions
) -> tuple[GateMemory, Decision]:
    """Decide on a fix: a measurement by which the filter may restart.

    Args:
        memory: of the gate.
        nis: normalised innovation squared against the estimate; nan if it cannot be computed.
        candidate_nis: of an unexpected fix, the same against the candidate; nan if there is none.
        bound: of the NIS, for as many numbers as were measured; inf without a gate.
        options: see FilterConfig.
    """
    streak, bound = memory.fixes, fix_bound(memory, bound)
    if is_expected(nis, bound):
        if streak.rejected == 0 and memory.slack == 0.0 and memory.others.rejected == 0:
            return memory, _ACCEPT
        return GateMemory(_NO_STREAK, 0, max(memory.slack - _SLACK_DOWN, 0.0), _NO_STREAK), _ACCEPT
    agrees = streak.rejected > 0 and is_expected(candidate_nis, bound)
    agreeing = memory.agreeing + 1 if agrees else 1
    slack = memory.slack + _SLACK_UP
    if agreeing >= options.relocation_fixes:
        # The gate was right to reject them: they were not noise.
        return GateMemory(_NO_STREAK, 0, max(slack - agreeing * _SLACK_UP, 0.0), _NO_STREAK), Decision(
            RELOCATED, agrees
        )
    streak = count_rejection(streak)
    if diverged(streak, options):
        return GateMemory(_NO_STREAK, 0, slack, _NO_STREAK), Decision(RELOCATED, agrees)
    return GateMemory(streak, agreeing, slack, memory.others), Decision(REJECTED, agrees)


def decide_other(memory: GateMemory, nis: float, bound: float, options: FilterOptions) -> tuple[GateMemory, Decision]:
    """Decide on a measurement that is no fix.

    Args:
        memory: of the gate.
        nis: normalised innovation squared; nan if it cannot be computed, inf if nothing can be expected.
        bound: of the NIS, as for :func:`decide_fix`.
        options: see FilterConfig.
    """
    if nis == math.inf:
        return memory, Decision(IGNORED, False)
    cleared = GateMemory(memory.fixes, memory.agreeing, memory.slack, _NO_STREAK)
    if is_expected(nis, bound):
        return cleared, _ACCEPT
    streak = count_rejection(memory.others)
    if diverged(streak, options):
        return cleared, Decision(RELOCATED, False)
    return GateMemory(memory.fixes, memory.agreeing, memory.slack, streak), Decision(REJECTED, False)
