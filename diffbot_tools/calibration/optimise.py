"""Maximum of the likelihood of the innovations over bounded quantities, and its curvature."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize

from diffbot_tools.calibration.events import Array, Events, Mask
from diffbot_tools.calibration.likelihood import Filtered, Prior, log_likelihood, run_events
from diffbot_tools.calibration.quantities import Quantity, with_values
from diffbot_tools.calibration.settings import Settings

_STEP = 0.01
"""[s] and in logarithms, for the gradient"""
_DELAY_STEP, _LOG_STEP = 0.02, 0.1
"""[s] and in logarithms, for the curvature"""
_LEAST = 1e-2
"""Least eigenvalue of the curvature scaled to a unit diagonal; a smaller one is a rounding error."""
_THREADS = 2
_HUGE = 1e12
_NEAR = 1e-3
"""A value this near to a bound is at it."""


class Fit(NamedTuple):
    """Optimum."""

    values: Array
    """(q,) of the quantities"""
    cost: float
    """negative log likelihood and prior"""
    covariance: Array
    """(q, q) by the curvature of the likelihood; zero rows for quantities at a bound"""
    at_bound: list[bool]


class Likelihood:
    """Negative log likelihood of drives, as a function of the quantities; evaluated for several points at a time."""

    def __init__(
        self, drives: list[Events], use: list[Mask], settings: Settings, prior: Prior, quantities: list[Quantity]
    ) -> None:
        """Take the drives and, for each, a mask (k,) of the measurements that count."""
        self.drives, self.settings, self.prior, self.quantities = drives, settings, prior, quantities
        self.use = use
        """mask (k,) of each drive"""
        self._pool: ThreadPoolExecutor | None = None
        self.on_evaluation: Callable[[], object] = lambda: None

    @contextmanager
    def threads(self) -> Iterator[None]:
        """Evaluate in threads inside this block; an interrupt leaves after the points that are under way."""
        self._pool = ThreadPoolExecutor(_THREADS)
        try:
            yield
        finally:
            self._pool.shutdown(wait=True, cancel_futures=True)
            self._pool = None

    def filtered(self, values: Array) -> list[Filtered]:
        """Filter all drives with these values (q,)."""
        settings = with_values(self.settings, self.quantities, values)
        return [run_events(one, self.prior, settings) for one in self.drives]

    def log_likelihood(self, values: Array) -> float:
        """Return the log likelihood of the measurements that count."""
        found = self.filtered(values)
        return sum(log_likelihood(one, use) for one, use in zip(found, self.use, strict=True))

    def cost(self, values: Array) -> float:
        """Return the negative log likelihood with the priors."""
        likelihood = self.log_likelihood(values)
        self.on_evaluation()
        prior = sum(one.penalty(value) for one, value in zip(self.quantities, values.tolist(), strict=True))
        return prior - likelihood if math.isfinite(likelihood) else _HUGE

    def negative(self, values: Array) -> float:
        """Return the negative log likelihood alone."""
        self.on_evaluation()
        return -self.log_likelihood(values)

    def map(self, function: Callable[[Array], float], points: list[Array]) -> Array:
        """Return a function at several points."""
        results = map(function, points) if self._pool is None else self._pool.map(function, points)
        return np.array(list(results))


def fit(likelihood: Likelihood, starts: list[Array]) -> Fit:
    """Minimise the cost from several starts; the curvature is that of the best."""
    bounds = [(one.lower, one.upper) for one in likelihood.quantities]
    best = None
    likelihood.log_likelihood(starts[0])  # compiles, which is not for several threads
    with likelihood.threads():
        for start in starts:
            found = minimize(
                lambda values: _with_gradient(likelihood, values),
                np.clip(start, *np.array(bounds).T),
                jac=True,
                method="L-BFGS-B",
                bounds=bounds,
                options={"maxiter": 60, "ftol": 1e-8},
            )
            if best is None or found.fun < best.fun:
                best = found
        values = np.asarray(best.x, dtype=np.float64)  # type: ignore[union-attr]
        bounded = [
            bool(value < one.lower + _NEAR or value > one.upper - _NEAR)
            for one, value in zip(likelihood.quantities, values, strict=True)
        ]
        covariance = _covariance(likelihood, values, bounded)
    return Fit(values, float(best.fun), covariance, bounded)  # type: ignore[union-attr]


def _with_gradient(likelihood: Likelihood, values: Array) -> tuple[float, Array]:
    """Return cost and gradient by central differences, one-sided at a bound."""
    upper = np.array([one.upper for one in likelihood.quantities])
    lower = np.array([one.lower for one in likelihood.quantities])
    points = [values]
    spans = []
    for index in range(len(values)):
        ahead, behind = values.copy(), values.copy()
        ahead[index] = min(values[index] + _STEP, upper[index])
        behind[index] = max(values[index] - _STEP, lower[index])
        points += [ahead, behind]
        spans.append(ahead[index] - behind[index])
    costs = likelihood.map(likelihood.cost, points)
    return float(costs[0]), (costs[1::2] - costs[2::2]) / np.array(spans)


def _covariance(likelihood: Likelihood, values: Array, bounded: list[bool]) -> Array:
    """Return the inverse of the curvature of the likelihood with the wide side of the priors."""
    free = [index for index, one in enumerate(bounded) if not one]
    count, steps = len(free), np.diag([_step(one) for one in likelihood.quantities])
    covariance = np.zeros((len(values), len(values)))
    if not free:
        return covariance
    pairs = [(i, j) for i in range(count) for j in range(i + 1)]
    points = []
    for i, j in pairs:
        a, b = steps[free[i]], steps[free[j]]
        points += [values + a + b, values + a - b, values - a + b, values - a - b]
    f = likelihood.map(likelihood.negative, points).reshape(-1, 4)
    curvature = np.zeros((count, count))
    for (i, j), one in zip(pairs, f, strict=True):
        area = 4.0 * steps[free[i]].sum() * steps[free[j]].sum()
        curvature[i, j] = curvature[j, i] = (one[0] - one[1] - one[2] + one[3]) / area
    prior = np.array([likelihood.quantities[index].spread ** -2.0 for index in free])
    # Along what the drive does not determine the curvature may come out negative; there the prior alone counts.
    scale = np.sqrt(np.maximum(np.diag(curvature), 0.0) + prior)
    curvature = (curvature + np.diag(prior)) / np.outer(scale, scale)
    eigenvalues, vectors = np.linalg.eigh(curvature)
    inverse = (vectors / np.maximum(eigenvalues, _LEAST)) @ vectors.T
    covariance[np.ix_(free, free)] = inverse / np.outer(scale, scale)
    return covariance


def _step(quantity: Quantity) -> float:
    return _LOG_STEP if quantity.logarithmic else _DELAY_STEP


def constants_of(likelihood: Likelihood, found: Fit) -> tuple[Array, Array]:
    """Return mean (6,) and covariance (6, 6) of the constant states, with what the quantities add to their uncertainty.

    Each drive starts from the same prior; their results are joined by information, the prior counted once.
    """
    mean, P = _joined(likelihood, found.values)
    J = np.zeros((6, len(found.values)))
    for index, bounded in enumerate(found.at_bound):
        if not bounded:
            step = np.zeros(len(found.values))
            step[index] = size = _step(likelihood.quantities[index])
            ahead, behind = (_joined(likelihood, found.values + sign * step)[0] for sign in (1.0, -1.0))
            J[:, index] = (ahead - behind) / (2.0 * size)
    return mean, P + J @ found.covariance @ J.T


def _joined(likelihood: Likelihood, values: Array) -> tuple[Array, Array]:
    prior = likelihood.prior
    used = np.flatnonzero(prior.sigma > 0.0)
    before = np.diag(prior.sigma[used] ** -2.0)
    information, weighted = before.copy(), before @ prior.mean[used]
    for one in likelihood.filtered(values):
        gained = np.linalg.inv(one.P[3:9, 3:9][np.ix_(used, used)]) - before
        information += gained
        # Of the mean, what the drive adds to the prior.
        weighted += (gained + before) @ one.x[3:9][used] - before @ prior.mean[used]
    P = np.zeros((6, 6))
    P[np.ix_(used, used)] = np.linalg.inv(information)
    mean = prior.mean.copy()
    mean[used] = P[np.ix_(used, used)] @ weighted
    return mean, P
