"""Random numbers that are a function of (seed, run, step): the same bits in any order, on any number of workers.

Philox-4x32-10 (Salmon, Moraes, Dror, Shaw, "Parallel random numbers: as easy as 1, 2, 3", SC 2011) is a counter-based
generator. Only products of 32-bit numbers and masks are used, so the same text runs as plain Python and compiled with
64-bit integers.
"""

from __future__ import annotations

import math
from typing import NamedTuple

_M0, _M1 = 0xD2511F53, 0xCD9E8D57
_W0, _W1 = 0x9E3779B9, 0xBB67AE85
_LOW = 0xFFFFFFFF
_UNIT = 2.0**-32

# Blocks of four numbers that one step may draw; each purpose has its own, whatever else is switched on.
WHEEL_BLOCK, FIX_BLOCK, FAULT_BLOCK, START_BLOCK, SLIP_BLOCK, GYRO_BLOCK = 0, 1, 2, 3, 4, 5
DETECTION_BLOCK, DETECTION_FAULT_BLOCK = 6, 7
LANDMARK_BLOCK = 16
"""of the first landmark of the map; the next ones follow"""


class NoiseKey(NamedTuple):
    """Names the noise of one step."""

    seed: int
    run: int
    step: int


class Words(NamedTuple):
    """Four random words of 32 bits."""

    a: int
    b: int
    c: int
    d: int


def philox(counter: Words, key_low: int, key_high: int) -> Words:
    """Philox-4x32 with 10 rounds; all arguments are words of 32 bits."""
    a, b, c, d = counter
    for _ in range(10):
        first = _M0 * a
        second = _M1 * c
        # The shifts are masked: compiled 64-bit products may look negative.
        a, b, c, d = (
            ((second >> 32) & _LOW) ^ b ^ key_low,
            second & _LOW,
            ((first >> 32) & _LOW) ^ d ^ key_high,
            first & _LOW,
        )
        key_low = (key_low + _W0) & _LOW
        key_high = (key_high + _W1) & _LOW
    return Words(a, b, c, d)


class Draw(NamedTuple):
    """Four independent numbers, uniform in (-1, 1)."""

    a: float
    b: float
    c: float
    d: float


def draw(seed: int, run: int, step: int, block: int) -> Draw:
    """Draw the four numbers of one block of one step of one run.

    Args:
        seed: of the campaign, 0 <= seed < 2^64.
        run: number of the run, 0 <= run < 2^64.
        step: number of the step, 0 <= step < 2^32.
        block: which four, 0 <= block < 2^32.
    """
    words = philox(Words(step, block, run & _LOW, (run >> 32) & _LOW), seed & _LOW, (seed >> 32) & _LOW)
    return Draw(
        (2.0 * words.a + 1.0) * _UNIT - 1.0,
        (2.0 * words.b + 1.0) * _UNIT - 1.0,
        (2.0 * words.c + 1.0) * _UNIT - 1.0,
        (2.0 * words.d + 1.0) * _UNIT - 1.0,
    )


def probability(number: float) -> float:
    """Map a number of :class:`Draw` from (-1, 1) to (0, 1)."""
    return 0.5 * (number + 1.0)


def direction(number: float) -> float:
    """Map a number of :class:`Draw` to an angle [rad] in (-pi, pi)."""
    return number * math.pi
