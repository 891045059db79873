"""Range and bearing of known landmarks, or one of them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from diffbot_control.filter.landmark_calibration import LandmarkErrors, with_landmark_errors
from diffbot_control.filter.measurements.measurement import Array, Measurement, Source, States
from diffbot_control.filter.models import LandmarkExpectation, expect_landmark, heading_innovation, is_at_landmark
from diffbot_core.geometry import Point, Pose

LANDMARKS = "landmarks"


@dataclass(frozen=True, eq=False)
class LandmarkMeasurement(Measurement):
    """Range and bearing of a known landmark in the frame of the robot."""

    range: float
    """[m]"""
    bearing: float
    """[rad]"""
    R: Array
    """(2, 2) covariance [m, rad]; a variance that is not finite marks a missing number"""
    landmark: Point
    """position in the frame of the estimate [m]"""

    @property
    def source(self) -> Source:
        """Each landmark has errors of its own."""
        return Source(LANDMARKS, self.landmark)

    @cached_property
    def _rows(self) -> list[int]:
        """Numbers that were measured: 0 for the range, 1 for the bearing."""
        return [row for row in (0, 1) if math.isfinite(self.R[row, row])]

    @property
    def z(self) -> Array:
        """Range [m] and bearing [rad], or one of them."""
        return np.array((self.range, self.bearing))[self._rows]

    def expected(self, x: Array, states: States) -> Array:
        """Return range and bearing from the pose."""
        found = self._expectation(x, states)
        return np.array((found.range, found.bearing))[self._rows]

    def jacobian(self, x: Array, states: States) -> Array:
        """Return the derivatives by position, heading and the errors of the sensor."""
        found = self._expectation(x, states)
        H = np.zeros((2, states.size))
        H[0, :2] = found.range_x, found.range_y
        H[1, :3] = found.bearing_x, found.bearing_y, -1.0
        part = states.landmarks
        if part.start < part.stop:
            H[0, part] = 1.0, math.hypot(self.landmark.x - x.item(0), self.landmark.y - x.item(1)), 0.0
            H[1, part.stop - 1] = 1.0
        return H[self._rows]

    def noise(self, x: Array, P: Array, states: States) -> Array:
        """Return R and the variance of the linearisation error."""
        found, rows = self._expectation(x, states, P.item(0, 0) + P.item(1, 1)), self._rows
        added = np.array((found.added_var_range, found.added_var_bearing))[rows]
        return self.R[np.ix_(rows, rows)] + np.diag(added)

    def residual(self, z: Array, expected: Array) -> Array:
        """Return measured minus expected numbers, the bearing the short way round."""
        y = z - expected
        if self._rows[-1] == 1:
            y[-1] = heading_innovation(z.item(-1), expected.item(-1))
        return y

    def is_defined(self, x: Array) -> bool:
        """Return False at the landmark, where no bearing is defined."""
        return not is_at_landmark(Pose(*x[:3].tolist()), self.landmark)

    def _expectation(self, x: Array, states: States, spread: float = 0.0) -> LandmarkExpectation:
        """Return what the sensor measures with its errors; ``spread`` as of :func:`models.expect_landmark`."""
        part = states.landmarks
        errors = LandmarkErrors(*x[part].tolist()) if part.start < part.stop else states.landmark_errors
        return with_landmark_errors(expect_landmark(Pose(*x[:3].tolist()), self.landmark, spread), errors)
