"""Statistics of many runs in little memory. The result does not depend on the order of the runs.

Only the numbers of values in bins are stored. These counts can be added exactly, in any order. A bin is 0.5 % wide, so
quantiles are accurate to 0.25 %.
"""

from __future__ import annotations

import math
from collections import Counter
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binomtest

from diffbot_sim.batch import COLUMNS

Array = NDArray[np.float64]

BIN_WIDTH = 0.005
"""width of a bin, as a share of its lower edge"""
SMALLEST = 1e-6
"""smaller values (in any unit) count as 0"""
LARGEST = 1e300
"""larger values, including infinity, count as this value"""
QUANTILES = (0.01, 0.05, 0.25, 0.5, 0.75, 0.95, 0.99)
METRICS = ("settling_time", "position_error", "heading_error", "path_length", "effort", "switches", "estimation_error")
"""Quantities of a run that are counted. A nan, for example the settling time of a run that did not settle, is not."""

_ZERO = -1
_LOG_BASE = math.log1p(BIN_WIDTH)


def bins_of(values: Array) -> dict[int, int]:
    """Return the number of values in each bin. Values must not be negative; nan is ignored."""
    values = np.minimum(values[~np.isnan(values)], LARGEST)
    with np.errstate(divide="ignore"):
        bins = np.floor(np.log(values / SMALLEST) / _LOG_BASE)
    bins = np.where(values < SMALLEST, _ZERO, bins).astype(np.int64)
    keys, counts = np.unique(bins, return_counts=True)
    return dict(zip(keys.tolist(), counts.tolist(), strict=True))


def value_of(key: int) -> float:
    """Return the middle of a bin."""
    return 0.0 if key == _ZERO else SMALLEST * math.exp((key + 0.5) * _LOG_BASE)


def quantile(bins: Counter[int], q: float) -> float:
    """Return the q-quantile: the smallest value that at least a share q of all values does not exceed; nan if empty."""
    total = sum(bins.values())
    if total == 0:
        return math.nan
    rank = max(1, math.ceil(q * total))
    counted = 0
    for key in sorted(bins):
        counted += bins[key]
        if counted >= rank:
            return value_of(key)
    return value_of(max(bins))


def wilson(successes: int, total: int) -> tuple[float, float]:
    """Return Wilson's 95 % confidence interval of a success rate in ``total`` >= 1 trials (JASA 22, 1927)."""
    interval = binomtest(successes, total).proportion_ci(0.95, method="wilson")
    return float(interval.low), float(interval.high)


class CellStatistics:
    """Counts of one cell."""

    def __init__(self) -> None:
        """Set all counts to zero."""
        self.runs = 0
        self.settled = 0
        self.reached_local = 0
        self.bins: dict[str, Counter[int]] = {metric: Counter() for metric in METRICS}

    def add(self, counts: dict[str, Any]) -> None:
        """Add the counts of a chunk from :func:`count_outcomes`."""
        self.runs += counts["runs"]
        self.settled += counts["settled"]
        self.reached_local += counts["reached_local"]
        for metric in METRICS:
            for key, count in counts["bins"][metric]:
                self.bins[metric][key] += count

    def summary(self) -> dict[str, Any]:
        """Return the success rate with its confidence interval, and the quantiles of each metric."""
        low, high = wilson(self.settled, self.runs)
        figures: dict[str, Any] = {
            "runs": self.runs,
            "success_rate": self.settled / self.runs,
            "success_low": low,
            "success_high": high,
            "reached_local_region": self.reached_local,
        }
        for metric in METRICS:
            for q in QUANTILES:
                value = quantile(self.bins[metric], q)
                # The number of switches is a whole number. Rounding is exact up to 200, where a bin is 1 wide.
                value = float(round(value)) if metric == "switches" and not math.isnan(value) else value
                figures[f"{metric}_q{100 * q:g}"] = None if math.isnan(value) else value
        return figures

    def ecdf(self, metric: str) -> tuple[list[float], list[float]]:
        """Return the empirical distribution: values, and for each value the share of runs that do not exceed it."""
        keys = sorted(self.bins[metric])
        shares = np.cumsum([self.bins[metric][key] for key in keys]) / self.runs
        return [value_of(key) for key in keys], shares.tolist()


def count_outcomes(outcomes: Array) -> dict[str, Any]:
    """Count outcomes (runs, 12), columns as batch.COLUMNS. The counts can be written as JSON.

    Bins are pairs of key and count, because the keys of JSON objects cannot be numbers.
    """
    column = {name: outcomes[:, index] for index, name in enumerate(COLUMNS)}
    values = {
        **{metric: column[metric] for metric in METRICS if metric in column},
        "position_error": np.hypot(column["x"], column["y"]),
        "heading_error": np.abs(column["theta"]),
    }
    return {
        "runs": len(outcomes),
        "settled": int(np.isfinite(column["settling_time"]).sum()),
        "reached_local": int(np.isfinite(column["local_time"]).sum()),
        "bins": {metric: sorted(bins_of(values[metric]).items()) for metric in METRICS},
    }
