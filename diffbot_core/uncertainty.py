"""How well a pose is known: standard deviations of position and heading."""

from __future__ import annotations

import math
from typing import NamedTuple

from diffbot_core.geometry import Pose


class Uncertainty(NamedTuple):
    """Standard deviations of the estimate."""

    xy: float
    """[m] of the position, along the longer axis of its error ellipse"""
    theta: float
    """[rad]"""


CERTAIN = Uncertainty(0.0, 0.0)
"""Of an estimate assumed exact: the default of library calls without an uncertainty.

A message never means this: its all-zero covariance means *unknown*.
"""


class Estimate(NamedTuple):
    """What a controller receives: where the robot is, and how well that is known."""

    pose: Pose
    """in the frame of the goal's pose, e.g. ``map``"""
    uncertainty: Uncertainty = CERTAIN


def largest_deviation(xx: float, xy: float, yy: float) -> float:
    """Standard deviation [m] along the longer axis of the error ellipse of a position with this covariance [m^2]."""
    half = 0.5 * (xx + yy)
    spread = math.hypot(0.5 * (xx - yy), xy)
    return math.sqrt(max(half + spread, 0.0))
