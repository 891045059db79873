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
_NEWTON_STEPS, _SAME = 4, 0.01
"""Steps by the curvature at most, and the cost that one has to gain."""
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
        self,
        drives: list[Events],
        use: list[Mask],
        settings: Settings,
        prior: Prior,
        quantities: list[Quantity],
        on_evaluation: Callable[[], object],
    ) -> None:
        """Take the drives, for each a mask (k,) of the measurements that count, and what to call on each evaluation."""
        self.drives, self.settings, self.prior, self.quantities = drives, settings, prior, quantities
        self.use = use
        """mask (k,) of each drive"""
        self.resolution = max(_period(one) for one in drives) / math.sqrt(12.0)
        """[s] deviation of a delay by messages that tell nothing of the motion between them"""
        self._pool: ThreadPoolExecutor | None = None
        self.on_evaluation = on_evaluation

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
        return self.negative(values) + sum(map(Quantity.penalty, self.quantities, values.tolist()))

    def negative(self, values: Array) -> float:
        """Return the negative log likelihood alone."""
        self.on_evaluation()
        likelihood = self.log_likelihood(values)
        return -likelihood if math.isfinite(likelihood) else _HUGE

    def map(self, function: Callable[[Array], float], points: list[Array]) -> Array:
        """Return a function at several points."""
        results = map(function, points) if self._pool is None else self._pool.map(function, points)
        return np.array(list(results))


def fit(likelihood: Likelihood, starts: list[Array]) -> Fit:
    """Minimise the cost from several starts; the curvature is that of the best.

    The line search ends early where the likelihood has kinks, as it has by the delay, since messages and measurements
    have stamps of their own. Steps by the curvature over a wider range go on from there.
    """
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
        values, cost = np.asarray(best.x, dtype=np.float64), float(best.fun)  # type: ignore[union-attr]
        for _ in range(_NEWTON_STEPS):
            bounded = _at_bounds(likelihood, values)
            covariance = _covariance(likelihood, values, bounded)
            _, gradient = _with_gradient(likelihood, values)
            next_values = np.clip(values - covariance @ gradient, *np.array(bounds).T)
            next_cost = likelihood.cost(next_values)
            if next_cost > cost - _SAME:
                break
            values, cost = next_values, next_cost
    resolution = [0.0 if one.logarithmic else likelihood.resolution**2 for one in likelihood.quantities]
    return Fit(values, cost, covariance + np.diag(resolution), bounded)


def _at_bounds(likelihood: Likelihood, values: Array) -> list[bool]:
    return [
        bool(value < one.lower + _NEAR or value > one.upper - _NEAR)
        for one, value in zip(likelihood.quantities, values, strict=True)
    ]


def _period(events: Events) -> float:
    """Return the time [s] for which nothing is known of changes of the motion: of a message, or of a turn rate."""
    message = float(np.median(events.odometry.end - events.odometry.start))
    return min(message, float(np.median(np.diff(events.rates.time)))) if len(events.rates.time) > 0 else message


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
    """Return the inverse of the curvature of the likelihood with the priors."""
    # A delay is continuous beyond its bound of 0; the logarithms at their bounds are not determined.
    free = [index for index, one in enumerate(bounded) if not (one and likelihood.quantities[index].logarithmic)]
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
    spread = np.array([likelihood.quantities[index].spread for index in free])
    # Along what the drive does not determine the curvature may come out negative; there the prior alone counts.
    eigenvalues, vectors = np.linalg.eigh(curvature * np.outer(spread, spread))
    inverse = (vectors / (1.0 + np.maximum(eigenvalues, 0.0))) @ vectors.T
    covariance[np.ix_(free, free)] = inverse * np.outer(spread, spread)
    return covariance


def _step(quantity: Quantity) -> float:
    return _LOG_STEP if quantity.logarithmic else _DELAY_STEP


def constants_of(likelihood: Likelihood, found: Fit) -> tuple[Array, Array]:
    """Return mean (6,) and covariance (6, 6) of the constant states, with what the quantities add to their uncertainty.

    Each drive starts from the same prior; their results are joined by information, the prior counted once.
    """
    mean, P = _joined(likelihood, found.values)
    J = np.zeros((6, len(found.values)))
    for index, variance in enumerate(found.covariance.diagonal()):
        if variance > 0.0:
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
