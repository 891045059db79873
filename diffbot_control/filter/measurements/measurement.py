"""The interface of a measurement: all that the filter knows of it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from diffbot_control.filter.landmark_calibration import NO_ERRORS, LandmarkErrors
from diffbot_control.filter.models import heading_innovation
from diffbot_core.geometry import Pose

Array = NDArray[np.float64]


class Source(NamedTuple):
    """Where a measurement comes from: errors of one source may be correlated in time, those of two are independent."""

    sensor: str
    """its name in settings and diagnostics, e.g. ``landmarks``"""
    place: tuple[float, ...] = ()
    """of what is measured, if the errors belong to it: the position of a landmark"""


class States(NamedTuple):
    """Where the states stand in x: the pose first, then by choice errors of the wheels and of landmarks."""

    size: int = 3
    """n, number of states"""
    wheels: slice = slice(3, 3)
    """errors of the wheels"""
    landmarks: slice = slice(3, 3)
    """errors of the sensor of landmarks"""
    gyro: slice = slice(3, 3)
    """bias of the gyro"""
    landmark_errors: LandmarkErrors = NO_ERRORS
    """the same, where they are no states but known"""


class Innovation(NamedTuple):
    """Measured minus expected numbers and their covariance, with the R that the measurement came with."""

    y: Array
    """(m,)"""
    S: Array
    """(m, m)"""


@dataclass(frozen=True, eq=False)
class Measurement(ABC):
    """Numbers z = h(x) + v that were measured at a time, with the covariance R of v; z has m <= 3 of them, x has n."""

    stamp: int
    """[ns]"""

    @property
    @abstractmethod
    def source(self) -> Source:
        """Where it comes from; measurements with equal stamps are fused in the order of their sources."""

    @property
    @abstractmethod
    def z(self) -> Array:
        """(m,) the measured numbers."""

    @abstractmethod
    def expected(self, x: Array, states: States) -> Array:
        """Return h(x) (m,)."""

    @abstractmethod
    def jacobian(self, x: Array, states: States) -> Array:
        """Return H = dh / dx (m, n)."""

    @abstractmethod
    def noise(self, x: Array, P: Array, states: States) -> Array:
        """Return R (m, m), with the variance that linearising h at this estimate adds."""

    def residual(self, z: Array, expected: Array) -> Array:
        """Return z - h(x) (m,), angles the short way round."""
        return z - expected

    def is_defined(self, x: Array) -> bool:
        """Return False if nothing can be expected at this state; the measurement is then ignored."""
        return True

    def restart(self, pose: Pose) -> tuple[Pose, Array] | None:
        """Return mean and covariance (3, 3) of the pose known by this measurement alone; None if it knows no position.

        Args:
            pose: the present estimate, for the mean of what the measurement does not know.
        """
        return None


@dataclass(frozen=True, eq=False)
class DirectMeasurement(Measurement):
    """Some of x, y, theta themselves: h(x) is a part of the state."""

    part: ClassVar[slice]
    """of the state, that is measured"""

    def expected(self, x: Array, states: States) -> Array:
        """Return the part of the state."""
        return x[self.part]

    def jacobian(self, x: Array, states: States) -> Array:
        """Return the rows of the identity."""
        return np.eye(3, states.size)[self.part]

    def residual(self, z: Array, expected: Array) -> Array:
        """Return measured minus expected numbers, the heading the short way round."""
        y = z - expected
        if self.part.stop == 3:
            y[-1] = heading_innovation(z.item(-1), expected.item(-1))
        return y


Key = tuple[int, Source, tuple[float, ...]]


def key_of(measurement: Measurement) -> Key:
    """Return stamp, source and numbers: the order of fusion, and the same only of duplicates."""
    return measurement.stamp, measurement.source, tuple(measurement.z.tolist())


def split_at(measurements: list[Measurement], stamp: int) -> tuple[list[Measurement], list[Measurement]]:
    """Part ordered measurements into those up to ``stamp`` [ns] and those after it."""
    if not measurements or measurements[-1].stamp <= stamp:
        return measurements, []
    ready = [one for one in measurements if one.stamp <= stamp]
    return ready, measurements[len(ready) :]
