"""Absolute measurements of the heading, as a compass gives them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from diffbot_control.filter.measurements.measurement import Array, DirectMeasurement, Source, States

HEADINGS = "headings"
_COMPASS = Source(HEADINGS)


@dataclass(frozen=True, eq=False)
class Heading(DirectMeasurement):
    """An absolute measurement of the heading."""

    part: ClassVar[slice] = slice(2, 3)

    theta: float
    """[rad]"""
    R: Array
    """(1, 1) variance [rad^2]"""
    source: Source = _COMPASS

    @property
    def z(self) -> Array:
        """Theta [rad]."""
        return np.array((self.theta,))

    def noise(self, x: Array, P: Array, states: States) -> Array:
        """Return R: a heading is linear in the states."""
        return self.R
