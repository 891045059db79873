"""Statistics of many runs, with 95 % intervals."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binom

from diffbot_lab.campaign.statistics import wilson
from diffbot_sim.batch import COLUMNS
from diffbot_tools.filter_statistics import quantiles

Array = NDArray[np.float64]

LEVELS = {"median": 0.5, "p95": 0.95, "p99": 0.99}
ANSWER_TIMES = (20, 30, 60)
"""[s] times at which the answered runs are counted"""


def bootstrap_interval(values: Array, level: float) -> tuple[float, float]:
    """Return the 95 % bootstrap percentile interval of a quantile, in the limit of infinitely many resamples.

    A resample consists of n values drawn from the sample with replacement. Its k-th smallest value is at most the j-th
    smallest value of the sample with the probability P(B >= k), where B has the binomial distribution of n draws with
    the probability j / n. So no resampling is needed (B. Efron, R. J. Tibshirani, An Introduction to the Bootstrap,
    1993, section 16.4).

    Args:
        values: (n,) values, n >= 1.
        level: level of the quantile, in (0, 1).
    """
    n = len(values)
    rank = max(1, math.ceil(level * n))
    at_most = binom.sf(rank - 1, n, np.arange(1, n + 1) / n)
    tail = 0.5 * (1.0 - 0.95)
    low, high = (min(int(np.searchsorted(at_most, share)), n - 1) for share in (tail, 1.0 - tail))
    ordered = np.sort(values)
    return float(ordered[low]), float(ordered[high])


def spread(values: Array) -> dict[str, Any]:
    """Return median, 95 % and 99 % quantile with their intervals, and the maximum. Without values, all are None."""
    result: dict[str, Any] = dict(quantiles(values, {**LEVELS, "max": 1.0}))
    for name, level in LEVELS.items():
        result[f"{name}_interval"] = None
        if len(values):
            low, high = bootstrap_interval(values, level)
            # The quantile is interpolated between two values, so it may lie outside the interval.
            result[f"{name}_interval"] = [min(low, result[name]), max(high, result[name])]
    return result


def figures_of(outcomes: Array) -> dict[str, Any]:
    """Return the statistics of outcomes (runs, 12), columns as batch.COLUMNS."""
    column = {name: outcomes[:, index] for index, name in enumerate(COLUMNS)}
    settled = np.isfinite(column["settling_time"])
    revolutions = column["turning"] / (2.0 * math.pi)
    answers = np.round(column["reached_time"], 9)
    answered = np.isfinite(answers)
    return {
        "runs": len(outcomes),
        "settled": int(settled.sum()),
        "settled_interval": list(wilson(int(settled.sum()), len(outcomes))),
        # Remove the rounding error of steps times period: 117 steps of 0.1 s are 11.7 s.
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
