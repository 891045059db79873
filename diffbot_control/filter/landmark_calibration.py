"""Systematic errors of the sensor that measures landmarks: offset and scale of its ranges, and its mounting angle.

They are the same for all landmarks and stay the same: a range is (1 + scale) d + offset for the distance d, a bearing
is the true one plus an offset. Pure functions of floats.
"""

from __future__ import annotations

from typing import NamedTuple

from diffbot_control.filter.models import LandmarkExpectation
from diffbot_core.geometry import wrap_angle


class LandmarkErrors(NamedTuple):
    """Errors that all measurements of landmarks have in common."""

    offset: float
    """[m] of the range"""
    scale: float
    """relative error of the range"""
    bearing: float
    """[rad] offset of the bearing"""


NO_ERRORS = LandmarkErrors(0.0, 0.0, 0.0)


def with_landmark_errors(expected: LandmarkExpectation, errors: LandmarkErrors) -> LandmarkExpectation:
    """Return what a sensor with these ``errors`` measures where ``expected`` is right.

    By the offset the range has the derivative 1, by the scale the distance, and the bearing by its offset 1.
    """
    stretch = 1.0 + errors.scale
    return LandmarkExpectation(
        stretch * expected.range + errors.offset,
        wrap_angle(expected.bearing + errors.bearing),
        stretch * expected.range_x,
        stretch * expected.range_y,
        expected.bearing_x,
        expected.bearing_y,
        stretch * stretch * expected.added_var_range,
        expected.added_var_bearing,
    )
