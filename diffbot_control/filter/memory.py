"""State of the filter between two messages: one immutable value."""

from __future__ import annotations

from typing import NamedTuple

from diffbot_control.filter.adaptation import Adaptation
from diffbot_control.filter.belief import Belief
from diffbot_control.filter.correlation import NO_STAMPS, Stamps
from diffbot_control.filter.fix_correlation import STANDING, FixCorrelation, Travelled, new_fix_correlation
from diffbot_control.filter.gate import GateMemory
from diffbot_control.filter.landmark_correlation import LandmarkCorrelation, new_landmark_correlation


class Memory(NamedTuple):
    """State of the filter."""

    belief: Belief
    candidate: Belief | None
    """hypothesis of the rejected fixes; None if there are none"""
    gate: GateMemory
    adaptation: Adaptation
    stamps: Stamps = NO_STAMPS
    """of the newest measurement of each source whose errors are correlated in time"""
    fix_correlation: FixCorrelation = new_fix_correlation()
    """of the fixes, where it is to be found"""
    travelled: Travelled = STANDING
    """since the newest fix"""
    landmarks: LandmarkCorrelation = new_landmark_correlation()
    """of the landmarks, where the correlation of their errors is to be found"""
    disagreement: float = 0.0
    """mean of :class:`slip.Disagreement`"""
