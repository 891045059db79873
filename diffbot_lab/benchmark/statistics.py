"""Figures of many runs, each with its 95 % interval."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binom

from diffbot_lab.campaign.statistics import wilson
from diffbot_sim.batch import COLUMNS
from diffbot_tools.figures import quantiles

Array = NDArray[np.float64]

LEVELS = {"median": 0.5, "p95": 0.95, "p99": 0.99}
ANSWER_TIMES = (20, 30, 60)
"""[s] at which the answered runs are counted"""


def bootstrap_interval(values: Array, level: float, confidence: float = 0.95) -> tuple[float, float]:
    """Return the bootstrap percentile interval of a quantile, as infinitely many resamples would give it.

    The k-th smallest of n values drawn with replacement is at most the j-th smallest of the sample with the
    probability P(B >= k), B binomial with n draws of j / n, so that no resampling is needed (B. Efron,
    R. J. Tibshirani, An Introduction to the Bootstrap, 1993, section 16.4).

    Args:
        values: (n,) n >= 1.
        level: of the quantile, in (0, 1).
        confidence: of the interval.
    """
    n = len(values)
    rank = max(1, math.ceil(level * n))
    at_most = binom.sf(rank - 1, n, np.arange(1, n + 1) / n)
    tail = 0.5 * (1.0 - confidence)
    low, high = (min(int(np.searchsorted(at_most, share)), n - 1) for share in (tail, 1.0 - tail))
    ordered = np.sort(values)
    return float(ordered[low]), float(ordered[high])


def spread(values: Array) -> dict[str, Any]:
    """Return median, 95 %, 99 % and maximum; each quantile with its interval. None if there are no values."""
    found: dict[str, Any] = dict(quantiles(values, {**LEVELS, "max": 1.0}))
    for name, level in LEVELS.items():
        found[f"{name}_interval"] = None
        if len(values):
            low, high = bootstrap_interval(values, level)
            # The figure itself is interpolated between two values.
            found[f"{name}_interval"] = [min(low, found[name]), max(high, found[name])]
    return found


def figures_of(outcomes: Array) -> dict[str, Any]:
    """Turn outcomes (runs, 12), see batch.COLUMNS, into the figures of one law in one case."""
    column = {name: outcomes[:, index] for index, name in enumerate(COLUMNS)}
    settled = np.isfinite(column["settling_time"])
    revolutions = column["turning"] / (2.0 * math.pi)
    answers = np.round(column["reached_time"], 9)
    answered = np.isfinite(answers)
    return {
        "runs": len(outcomes),
        "settled": int(settled.sum()),
        "settled_interval": list(wilson(int(settled.sum()), len(outcomes))),
        # Whole steps: 117 of 0.1 s are 11.7 s, without the rounding error of the product.
        "settling_time": spread(np.round(column["settling_time"][settled], 9)),
        "position": spread(np.hypot(column["x"], column["y"])),
        "heading": spread(np.abs(column["theta"])),
        "filter": spread(column["estimation_error"]),
        "effort": spread(column["effort"]),
        "switches": spread(column["switches"]),
        "answered_by": {str(time): int((answers <= time).sum()) for time in ANSWER_TIMES},
        "answered_interval": list(wilson(int((answers <= ANSWER_TIMES[-1]).sum()), len(outcomes))),
        "reached": int(answered.sum()),
        "reached_time": spread(answers[answered]),
        "false_reached": int(column["false_reached"].sum()),
        "false_reached_interval": list(wilson(int(column["false_reached"].sum()), len(outcomes))),
        "revolutions": float(revolutions.max()),
    }
