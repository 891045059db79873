"""Random numbers as a function of (seed, run, step): the same in any order, on any number of workers.

numpy's Philox generator (Salmon, Moraes, Dror, Shaw, "Parallel random numbers: as easy as 1, 2, 3", SC 2011) maps a
counter and a key to four numbers. The key is (seed, run), the counter is (step, purpose). Each purpose therefore has
its own four numbers in each step, whatever else is switched on.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MOTION, FIX, FIX_FAULT, FURTHER, DETECTION, DETECTION_FAULT, LANDMARKS = range(7)
"""Purposes. MOTION: left drive or v, right drive or omega, left encoder, right encoder. FIX, DETECTION: x, y, theta.
FIX_FAULT, DETECTION_FAULT: dropout, outlier, its direction. FURTHER: heading, gyro, slip (2). LANDMARKS and those that
follow: range and bearing of two landmarks each."""
_START = 2**32
"""Purpose of the numbers from which a run's start is drawn."""


class NoiseSource:
    """Draws the noise of runs."""

    def __init__(self) -> None:
        """Create the generator."""
        self._bits = np.random.Philox(key=np.zeros(2, dtype=np.uint64))
        self._generator = np.random.Generator(self._bits)
        self._state: Any = self._bits.state
        self._counter, self._key = self._state["state"]["counter"], self._state["state"]["key"]

    def draw(self, seed: int, run: int, first: int, purpose: int, numbers: Array) -> None:
        """Fill ``numbers`` (n, 4) with the numbers in [0, 1) of a purpose in the steps from ``first`` on."""
        self._counter[0], self._counter[1] = first, purpose
        self._key[0], self._key[1] = seed, run
        self._bits.state = self._state
        self._generator.random(out=numbers)

    def rows(self, seed: int, run: int, first: int, noise: Array, purposes: Collection[int]) -> None:
        """Fill the ``purposes`` of ``noise`` (purposes, n, 4) for the n steps from ``first`` on; leave the others."""
        for purpose in purposes:
            self.draw(seed, run, first, purpose, noise[purpose])

    def run(self, seed: int, run: int, steps: int, purposes: Collection[int]) -> Array:
        """Return the noise (largest purpose + 1, steps, 4) of a run; only the ``purposes`` are filled."""
        noise = np.empty((max(purposes) + 1, steps, 4))
        self.rows(seed, run, 0, noise, purposes)
        return noise

    def start(self, seed: int, run: int) -> Array:
        """Return the four numbers in [0, 1) from which the start of a run is drawn."""
        numbers = np.empty((1, 4))
        self.draw(seed, run, 0, _START, numbers)
        row: Array = numbers[0]
        return row


def quiet_noise(steps: int, landmarks: int) -> Array:
    """Return the noise (purposes, steps, 4) of a run without any error: each number is 0.5."""
    return np.full((LANDMARKS + (landmarks + 1) // 2, steps, 4), 0.5)


def uniform(number: float, bound: float) -> float:
    """Map a number in [0, 1) to an error that is uniform within +-``bound``."""
    return bound * (2.0 * float(number) - 1.0)


def half_normal(number: float, other: float, scale: float) -> tuple[float, float]:
    """Map two numbers in [0, 1) to two independent values |N(0, scale)|.

    Box and Muller's transform, "A note on the generation of random normal deviates", Ann. Math. Stat. 29 (1958).
    """
    radius, angle = scale * math.sqrt(-2.0 * math.log1p(-float(number))), 2.0 * math.pi * float(other)
    return abs(radius * math.cos(angle)), abs(radius * math.sin(angle))
