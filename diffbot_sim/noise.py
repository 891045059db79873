"""Random numbers that depend only on seed, run, step and purpose, not on the order in which they are drawn.

NumPy's Philox generator (Salmon, Moraes, Dror, Shaw, "Parallel random numbers: as easy as 1, 2, 3", SC 2011) maps a
counter and a key to four numbers. The key is (seed, run), the counter is (step, purpose). Each purpose therefore has
its own four numbers in each step, and a sensor that is switched on does not change the noise of the others.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MOTION, FIX, FIX_FAULT, FURTHER, DETECTION, DETECTION_FAULT, LANDMARKS = range(7)
"""Purposes, and what their four numbers are for. MOTION: left drive or v, right drive or omega, left encoder, right
encoder. FIX, DETECTION: x, y, theta. FIX_FAULT, DETECTION_FAULT: dropout, outlier, direction of the outlier. FURTHER:
heading, gyro, slip left, slip right. LANDMARKS and the numbers above it: range and bearing of two landmarks each."""
_START = 2**32
"""Purpose of the numbers that determine the start of a run."""


class NoiseSource:
    """Random number generator for the noise of runs."""

    def __init__(self) -> None:
        """Create the generator."""
        self._bits = np.random.Philox(key=np.zeros(2, dtype=np.uint64))
        self._generator = np.random.Generator(self._bits)
        self._state: Any = self._bits.state
        self._counter, self._key = self._state["state"]["counter"], self._state["state"]["key"]

    def draw(self, seed: int, run: int, first: int, purpose: int, numbers: Array) -> None:
        """Fill ``numbers`` (n, 4) with numbers in [0, 1) for one purpose and the n steps from ``first`` on."""
        self._counter[0], self._counter[1] = first, purpose
        self._key[0], self._key[1] = seed, run
        self._bits.state = self._state
        self._generator.random(out=numbers)

    def rows(self, seed: int, run: int, first: int, noise: Array, purposes: Collection[int]) -> None:
        """Fill the rows ``purposes`` of ``noise`` (all purposes, n, 4) for the n steps from ``first`` on."""
        for purpose in purposes:
            self.draw(seed, run, first, purpose, noise[purpose])

    def run(self, seed: int, run: int, steps: int, purposes: Collection[int]) -> Array:
        """Return the noise (largest purpose + 1, steps, 4) of a run. Only the rows ``purposes`` are filled."""
        noise = np.empty((max(purposes) + 1, steps, 4))
        self.rows(seed, run, 0, noise, purposes)
        return noise

    def start(self, seed: int, run: int) -> Array:
        """Return the four numbers in [0, 1) that determine the start of a run."""
        numbers = np.empty((1, 4))
        self.draw(seed, run, 0, _START, numbers)
        row: Array = numbers[0]
        return row


def quiet_noise(landmarks: int) -> Array:
    """Return noise (purposes, 1, 4) of one step in which every number is 0.5, so all uniform errors are zero."""
    return np.full((LANDMARKS + (landmarks + 1) // 2, 1, 4), 0.5)


def uniform(number: float, bound: float) -> float:
    """Map a number in [0, 1) to an error uniform within +-``bound``."""
    return bound * (2.0 * float(number) - 1.0)


def half_normal(number: float, other: float, scale: float) -> tuple[float, float]:
    """Map two numbers in [0, 1) to two independent values |N(0, scale)|.

    From Box and Muller, "A note on the generation of random normal deviates", Ann. Math. Stat. 29 (1958).
    """
    radius, angle = scale * math.sqrt(-2.0 * math.log1p(-float(number))), 2.0 * math.pi * float(other)
    return abs(radius * math.cos(angle)), abs(radius * math.sin(angle))
