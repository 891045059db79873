"""Noise of a measurement: the covariance in its message, or the one that the parameters give.

An all-zero covariance in a message means *unknown*, never *exact*: the fallback is used, and without one the message is
dropped.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from diffbot_control.filter.covariance import UnknownCovarianceError
from diffbot_control.filter.measurements import Array


class KnownNoise(NamedTuple):
    """Configured noise of a sensor, beside the covariances in its messages."""

    R: Array | None = None
    """fallback covariance; None if there is none"""
    always: bool = False
    """use R even if a message has a covariance"""


MESSAGE_NOISE = KnownNoise()
"""The messages' covariances are used, and a message without one is dropped."""


def diagonal(sigmas: Sequence[float]) -> Array | None:
    """Return the covariance of independent errors; None if a standard deviation is 0: unknown."""
    return np.diag(np.square(sigmas)) if all(sigmas) else None


def noise_of(read: Callable[[], Array], noise: KnownNoise) -> Array:
    """Return the covariance that ``read`` gets from a message, or the fallback.

    The fallback is used if it overrides the message, or if the message's covariance is unknown: all zero, singular or
    absurdly large.

    Raises:
        BadMessageError: if the covariance is wrong (not finite, not symmetric, indefinite), which is the sign of a
            broken sender, or unknown and there is no fallback.
    """
    if noise.R is not None and noise.always:
        return noise.R
    try:
        return read()
    except UnknownCovarianceError:
        if noise.R is None:
            raise
        return noise.R
