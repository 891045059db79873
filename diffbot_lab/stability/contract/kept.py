"""Shares of steps and runs that keep a contract, with intervals, and the time from which a run keeps it."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from diffbot_core.errors import InvalidValueError
from diffbot_lab.campaign.statistics import wilson
from diffbot_lab.stability.tuned.contract import Contract

Mask = NDArray[np.bool_]
_Z = 1.959963984540054
"""of an interval of 95 %"""


class Kept(NamedTuple):
    """How often an estimate keeps a contract, with intervals of 95 %."""

    steps: float
    """share of the steps"""
    steps_low: float
    steps_high: float
    runs: float
    """share of the runs that keep it in every step"""
    runs_low: float
    runs_high: float


def errors_within(errors: NDArray[np.floating[Any]], contract: Contract) -> Mask:
    """Return where position and heading are within the contract; a step without an estimate (nan) is not.

    Args:
        errors: (..., 3) estimated minus true pose [m, m, rad], the heading's wrapped.
        contract: its bounds of position and heading; the standard deviation is not looked at.
    """
    distance, heading = np.hypot(errors[..., 0], errors[..., 1]), np.abs(errors[..., 2])
    within: Mask = (distance <= contract.eps_position) & (heading <= contract.eps_theta)
    return within


def shares(kept: Mask) -> Kept:
    """Count the steps and the runs that keep a contract.

    Steps of one run depend on each other: the interval of their share is that of the mean over the runs. It has no
    width if all runs have the same share.

    Args:
        kept: (runs, steps).

    Raises:
        InvalidValueError: for less than two runs, which have no interval.
    """
    if len(kept) < 2:
        raise InvalidValueError("runs", len(kept), ">= 2")
    of_runs = kept.mean(axis=1)
    mean, half = float(of_runs.mean()), _Z * float(of_runs.std(ddof=1)) / math.sqrt(len(of_runs))
    whole = int(kept.all(axis=1).sum())
    low, high = wilson(whole, len(kept))
    return Kept(mean, max(mean - half, 0.0), min(mean + half, 1.0), whole / len(kept), float(low), float(high))


def holds_from(kept: Mask, sampling_time: float) -> NDArray[np.float64]:
    """Return the time [s] of each run from which on it keeps a contract to its end; inf if it does not at its end.

    Args:
        kept: (runs, steps), from time 0 on.
        sampling_time: [s]
    """
    broken = ~kept
    after_last = np.where(broken.any(axis=1), kept.shape[1] - np.argmax(broken[:, ::-1], axis=1), 0)
    times: NDArray[np.float64] = np.where(broken[:, -1], np.inf, after_last * sampling_time)
    return times
