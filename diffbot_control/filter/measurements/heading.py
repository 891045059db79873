"""Absolute measurements of the heading, as a compass gives them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from diffbot_control.filter.measurements.measurement import Array, Measurement, Source, States
from diffbot_control.filter.models import heading_innovation

HEADINGS = "headings"
_COMPASS = Source(HEADINGS)


@dataclass(frozen=True, eq=False)
class Heading(Measurement):
    """An absolute measurement of the heading."""

    theta: float
    """[rad]"""
    R: Array
    """(1, 1) variance [rad^2]"""
    source: Source = _COMPASS

    @property
    def z(self) -> Array:
        """Theta [rad]."""
        return np.array((self.theta,))

    def expected(self, x: Array, states: States) -> Array:
        """Return the heading."""
        return x[2:3]

    def jacobian(self, x: Array, states: States) -> Array:
        """Return H = [0 0 1 0]."""
        H = np.zeros((1, states.size))
        H[0, 2] = 1.0
        return H

    def noise(self, x: Array, P: Array, states: States) -> Array:
        """Return R: a heading is linear in the states."""
        return self.R

    def residual(self, z: Array, expected: Array) -> Array:
        """Return measured minus expected heading."""
        return np.array((heading_innovation(z.item(), expected.item()),))
