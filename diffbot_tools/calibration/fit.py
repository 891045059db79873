"""Maximise the likelihood of the innovations over bounded quantities, and compute their covariance."""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize

from diffbot_control.filter.models import WHEELS
from diffbot_tools.calibration.events import Array, Events, Mask
from diffbot_tools.calibration.kernel import RATES, TERM, Filtered, Settings, run_events
from diffbot_tools.calibration.quantities import CONSTANTS, Quantity, with_values

_STEP = 0.01
"""Step for the gradient: [s] for a delay, and the same number for logarithms."""
_DELAY_STEP, _LOG_STEP = 0.02, 0.1
"""Steps for the curvature: [s] for a delay, and for logarithms."""
_NEWTON_STEPS, _MIN_REDUCTION = 4, 0.01
"""Largest number of Newton steps, and the smallest reduction of the cost by a step."""
_THREADS = 2
_HUGE = 1e12
"""Cost if the filter breaks down."""
_CONSTANT_STATES = np.array(list(CONSTANTS.values()))
_NEAR = 1e-3
"""A value within this distance of a bound is at the bound."""


class Fit(NamedTuple):
    """Values with the largest likelihood."""

    values: Array
    """(q,) values of the quantities"""
    cost: float
    """negative log likelihood with the priors"""
    covariance: Array
    """(q, q) inverse of the curvature of the cost, plus a delay's resolution; zero rows for logarithms at a bound"""
    at_bound: list[bool]


class Likelihood(NamedTuple):
    """Negative log likelihood of drives, as a function of the quantities."""

    drives: list[Events]
    use: list[Mask]
    """mask (k,) of the measurements that count, for each drive"""
    settings: Settings
    quantities: list[Quantity]
    on_evaluation: Callable[[], object]
    """called after each evaluation, in any thread"""

    def filtered(self, values: Array) -> list[Filtered]:
        """Filter all drives with these values (q,)."""
        settings = with_values(self.settings, self.quantities, values)
        return [run_events(one, settings) for one in self.drives]

    def cost(self, values: Array) -> float:
        """Return the negative log likelihood with the priors."""
        return self.negative(values) + sum(map(Quantity.penalty, self.quantities, values.tolist()))

    def negative(self, values: Array) -> float:
        """Return the negative log likelihood of the measurements in ``use``; it is huge if the filter breaks down."""
        terms = [one.result[use][:, (TERM, RATES)] for one, use in zip(self.filtered(values), self.use, strict=True)]
        self.on_evaluation()
        total = -float(sum(one.sum() for one in terms))
        return total if math.isfinite(total) else _HUGE


def fit(likelihood: Likelihood, starts: list[Array]) -> Fit:
    """Minimise the cost from several starts, and return the best minimum with its covariance.

    The likelihood has kinks along the delay, because stamps of messages and measurements differ. A line search may end
    early at a kink. Newton steps, whose derivatives span a wider range, continue from there.
    """
    quantities = likelihood.quantities
    bounds = np.array([(one.lower, one.upper) for one in quantities])
    likelihood.filtered(starts[0])  # compiles the filter, which must not happen in several threads
    searches = [
        minimize(
            lambda values: _with_gradient(likelihood, values),
            np.clip(start, *bounds.T),
            jac=True,
            method="L-BFGS-B",
            bounds=bounds,
            options={"maxiter": 60, "ftol": 1e-8},
        )
        for start in starts
    ]
    best = min(searches, key=lambda one: one.fun)
    values, cost = np.asarray(best.x, dtype=np.float64), float(best.fun)
    bounded, covariance = _curvature(likelihood, values)
    for _ in range(_NEWTON_STEPS):
        _, gradient = _with_gradient(likelihood, values)
        next_values = np.clip(values - covariance @ gradient, *bounds.T)
        next_cost = likelihood.cost(next_values)
        if next_cost > cost - _MIN_REDUCTION:
            break
        values, cost = next_values, next_cost
        bounded, covariance = _curvature(likelihood, values)
    # The motion within a message is unknown, which limits the resolution of the delay.
    resolution = max(map(_period, likelihood.drives)) / math.sqrt(12.0)
    return Fit(
        values,
        cost,
        covariance + np.diag([0.0 if one.logarithmic else resolution**2 for one in quantities]),
        bounded,
    )


def _period(events: Events) -> float:
    """Return the median time [s] between odometry messages, or between turn rates if they are more frequent."""
    message = float(np.median(events.odometry.end - events.odometry.start))
    return min(message, float(np.median(np.diff(events.rates.time)))) if len(events.rates.time) > 0 else message


def _evaluate(function: Callable[[Array], float], points: list[Array]) -> Array:
    """Evaluate a function at several points in threads."""
    with ThreadPoolExecutor(_THREADS) as pool:
        return np.array(list(pool.map(function, points)))


def _with_gradient(likelihood: Likelihood, values: Array) -> tuple[float, Array]:
    """Return cost and gradient by central differences, one-sided at a bound."""
    points = [values]
    for index, one in enumerate(likelihood.quantities):
        ahead, behind = values.copy(), values.copy()
        ahead[index] = min(values[index] + _STEP, one.upper)
        behind[index] = max(values[index] - _STEP, one.lower)
        points += [ahead, behind]
    costs = _evaluate(likelihood.cost, points)
    spans = (np.array(points[1::2]) - np.array(points[2::2])).diagonal()
    return float(costs[0]), (costs[1::2] - costs[2::2]) / spans


def _curvature(likelihood: Likelihood, values: Array) -> tuple[list[bool], Array]:
    """Return which values are at a bound, and the inverse (q, q) of the curvature of the likelihood with the priors."""
    quantities = likelihood.quantities
    bounded = [
        bool(value < one.lower + _NEAR or value > one.upper - _NEAR)
        for one, value in zip(quantities, values, strict=True)
    ]
    # The likelihood is continuous beyond the bound 0 of a delay. A logarithm at its bound is not determined.
    free = [index for index, one in enumerate(bounded) if not (one and quantities[index].logarithmic)]
    covariance = np.zeros((len(values), len(values)))
    if not free:
        return bounded, covariance
    steps = np.diag([_step(one) for one in quantities])
    pairs, points = [(i, j) for i in range(len(free)) for j in range(i + 1)], []
    for i, j in pairs:
        a, b = steps[free[i]], steps[free[j]]
        points += [values + a + b, values + a - b, values - a + b, values - a - b]
    curvature = np.zeros((len(free), len(free)))
    for (i, j), one in zip(pairs, _evaluate(likelihood.negative, points).reshape(-1, 4), strict=True):
        area = 4.0 * steps[free[i]].sum() * steps[free[j]].sum()
        curvature[i, j] = curvature[j, i] = (one[0] - one[1] - one[2] + one[3]) / area
    spread = np.array([quantities[index].spread for index in free])
    # The curvature may be negative in directions that the drive does not determine. There, only the prior counts.
    eigenvalues, vectors = np.linalg.eigh(curvature * np.outer(spread, spread))
    inverse = (vectors / (1.0 + np.maximum(eigenvalues, 0.0))) @ vectors.T
    covariance[np.ix_(free, free)] = inverse * np.outer(spread, spread)
    return bounded, covariance


def _step(quantity: Quantity) -> float:
    return _LOG_STEP if quantity.logarithmic else _DELAY_STEP


def constants_of(likelihood: Likelihood, found: Fit) -> tuple[Array, Array]:
    """Return mean (6,) and covariance (6, 6) of the constant states, including the uncertainty of the quantities."""
    mean, P = joined_constants(likelihood, found.values)
    J = np.zeros((len(_CONSTANT_STATES), len(found.values)))
    for index in np.flatnonzero(found.covariance.diagonal() > 0.0):
        step = np.zeros(len(found.values))
        step[index] = size = _step(likelihood.quantities[index])
        ahead, behind = (joined_constants(likelihood, found.values + sign * step)[0] for sign in (1.0, -1.0))
        J[:, index] = (ahead - behind) / (2.0 * size)
    return mean, P + J @ found.covariance @ J.T


def joined_constants(likelihood: Likelihood, values: Array) -> tuple[Array, Array]:
    """Return mean (6,) and covariance (6, 6) of the constant states for given values (q,) of the quantities.

    All drives start from the same prior. Their information matrices are added, and the prior is counted once.
    """
    options = likelihood.settings.options
    mean, variances = (np.array(one)[_CONSTANT_STATES - WHEELS] for one in (options.errors, options.variances))
    used = np.flatnonzero(variances > 0.0)
    places, before = _CONSTANT_STATES[used], np.diag(1.0 / variances[used])
    information, weighted = before.copy(), before @ mean[used]
    for one in likelihood.filtered(values):
        total = np.linalg.inv(one.P[np.ix_(places, places)])
        information += total - before
        weighted += total @ one.x[places] - before @ mean[used]
    P = np.zeros((len(_CONSTANT_STATES), len(_CONSTANT_STATES)))
    P[np.ix_(used, used)] = np.linalg.inv(information)
    mean[used] = P[np.ix_(used, used)] @ weighted
    return mean, P
