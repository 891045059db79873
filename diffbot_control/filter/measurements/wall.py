"""The distance to a known wall along a beam, as an ultrasonic sensor or a laser gives it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np

from diffbot_control.filter.measurements.measurement import Array, Measurement, Source, States
from diffbot_control.filter.wall_map import Wall
from diffbot_core.geometry import Pose

WALLS = "walls"
_MIN_INCIDENCE = 0.1
"""sine of the angle between beam and wall below which a range says little, and an echo may not come back"""


class _Hit(NamedTuple):
    """Where a beam meets a wall: its length t = (q - p) x e / (u x e), and the derivatives of t."""

    length: float
    """[m]"""
    by_x: float
    by_y: float
    by_angle: float
    """[m/rad] by the direction of the beam"""
    incidence: float
    """sine of the angle between beam and wall"""


@dataclass(frozen=True, eq=False)
class WallRange(Measurement):
    """Length of a beam from its origin on the robot to the nearest wall in its way."""

    range: float
    """[m]"""
    R: Array
    """(1, 1) variance [m^2]"""
    beam: Pose
    """origin and direction in the frame of the robot [m, m, rad]"""
    walls: tuple[Wall, ...]
    """of the map"""

    may_reset: ClassVar[bool] = False

    @property
    def source(self) -> Source:
        """Each beam has errors of its own."""
        return Source(WALLS, self.beam)

    @property
    def z(self) -> Array:
        """Length of the beam [m]."""
        return np.array((self.range,))

    def is_defined(self, x: Array) -> bool:
        """Return False if the beam meets no wall, or one at too flat an angle."""
        hit = self._hit(x)
        return hit is not None and hit.incidence >= _MIN_INCIDENCE

    def expected(self, x: Array, states: States) -> Array:
        """Return the length of the beam."""
        return np.array((self._nearest(x).length,))

    def jacobian(self, x: Array, states: States) -> Array:
        """Return the derivatives by position and heading; with the heading, the origin of the beam moves, too."""
        hit, theta = self._nearest(x), x.item(2)
        c, s = math.cos(theta), math.sin(theta)
        x_theta, y_theta = -s * self.beam.x - c * self.beam.y, c * self.beam.x - s * self.beam.y
        H = np.zeros((1, states.size))
        H[0, :3] = hit.by_x, hit.by_y, hit.by_x * x_theta + hit.by_y * y_theta + hit.by_angle
        return H

    def noise(self, x: Array, P: Array, states: States) -> Array:
        """Return R."""
        return self.R

    def _nearest(self, x: Array) -> _Hit:
        hit = self._hit(x)
        if hit is None:
            raise ValueError("the beam meets no wall: see is_defined")
        return hit

    def _hit(self, x: Array) -> _Hit | None:
        """Return where the beam meets the first wall from the pose in ``x``."""
        px, py, theta = x.tolist()[:3]
        c, s = math.cos(theta), math.sin(theta)
        px, py = px + c * self.beam.x - s * self.beam.y, py + s * self.beam.x + c * self.beam.y
        ux, uy = math.cos(theta + self.beam.theta), math.sin(theta + self.beam.theta)
        hits = []
        for start, end in self.walls:
            ex, ey, dx, dy = end.x - start.x, end.y - start.y, start.x - px, start.y - py
            across = ux * ey - uy * ex
            if across == 0.0:
                continue
            length, along = (dx * ey - dy * ex) / across, (dx * uy - dy * ux) / across
            if length > 0.0 and 0.0 <= along <= 1.0:
                by_angle = length * (ux * ex + uy * ey) / across
                hits.append(_Hit(length, -ey / across, ex / across, by_angle, abs(across) / math.hypot(ex, ey)))
        return min(hits, default=None)
