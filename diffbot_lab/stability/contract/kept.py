"""Which steps and runs keep a contract, with intervals, from when on, and the bounds that most runs keep."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from diffbot_core.errors import InvalidValueError
from diffbot_lab.campaign.statistics import wilson
from diffbot_lab.stability.contract.deviations import BOUNDED, DISTANCE
from diffbot_lab.stability.plan import SLOPES, Contract

Mask = NDArray[np.bool_]
Array = NDArray[np.float64]
_LEAST = 1e-3
"""[m], [rad], [m/s], [rad/s] no bound that is fitted is smaller"""


class Kept(NamedTuple):
    """Share of the runs that keep a contract in every step, with an interval of 95 %."""

    runs: float
    low: float
    high: float


def kept(deviations: Array, contract: Contract) -> Mask:
    """Return (runs, steps) where all that a contract bounds is within its bounds.

    Args:
        deviations: (runs, steps, 7), see :mod:`diffbot_lab.stability.contract.deviations`.
        contract: its bounds.
    """
    bounds = np.array([getattr(contract, name) for name in BOUNDED])
    return np.asarray((_beyond_slopes(deviations, contract) <= bounds).all(axis=-1))


def _beyond_slopes(deviations: Array, contract: Contract) -> Array:
    """Return the columns BOUNDED, less what the contract's slopes allow at the distance of each step."""
    beyond = deviations[..., : len(BOUNDED)].copy()
    for column, name in enumerate(SLOPES):
        beyond[..., column] -= getattr(contract, name) * deviations[..., DISTANCE]
    return beyond


def share_of(within: Mask) -> Kept:
    """Return the share of the runs (runs, steps) that keep a contract in every step.

    Raises:
        InvalidValueError: for less than two runs, which have no interval.
    """
    if len(within) < 2:
        raise InvalidValueError("runs", len(within), ">= 2")
    whole = int(within.all(axis=1).sum())
    low, high = wilson(whole, len(within))
    return Kept(whole / len(within), float(low), float(high))


def holds_from(within: Mask, on_leg: Mask, t_s: float) -> Array:
    """Return the time [s] of each run (runs,) from which it keeps a contract to its end, and at which no leg is driven.

    It is infinite for a run that does not keep it at its end.

    Args:
        within: (runs, steps), from time 0 on.
        on_leg: (runs, steps) a leg of the finish is being driven.
        t_s: [s]
    """
    to_the_end = np.logical_and.accumulate(within[:, ::-1], axis=1)[:, ::-1] & ~on_leg
    times: Array = np.where(to_the_end.any(axis=1), np.argmax(to_the_end, axis=1) * t_s, np.inf)
    return times


def fitted(deviations: Array, contract: Contract, share: float) -> dict[str, float]:
    """Return bounds that a share of the runs keeps in all of these steps, each by itself; two digits, rounded up.

    Args:
        deviations: (runs, steps, 7).
        contract: whose slopes are kept.
        share: of the runs.
    """
    found = {}
    for name, worst in zip(BOUNDED, _beyond_slopes(deviations, contract).max(axis=1).T, strict=True):
        value = max(float(np.quantile(worst, share, method="inverted_cdf")), _LEAST)
        digit = 10.0 ** (math.floor(math.log10(value)) - 1) if value < math.inf else 1.0
        found[name] = round(math.ceil(value / digit) * digit, 9) if value < math.inf else math.inf
    return found
