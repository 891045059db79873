"""The estimate over two hypotheses on the errors of a sensor: they are as configured, or they differ.

To estimate an error that is not there costs accuracy. Before the first measurement, both hypotheses are equally likely
for the sensor of landmarks; for the wheels, the user says how likely.
The filter runs under the second one. Its belief given the configured errors is the estimate under the first, and the
density of these errors now over that at the start is how much more likely the first has become (the density ratio of
Savage and Dickey). So there is no second filter, and nothing to be remembered. The wheels and the sensor of landmarks
have a pair of hypotheses each.
"""

from __future__ import annotations

import math

import numpy as np

from diffbot_control.filter.measurements.measurement import Array
from diffbot_control.filter.options import FilterOptions
from diffbot_core.geometry import wrap_angle

Three = tuple[float, float, float]
EVEN = 0.5
"""probability of either of two hypotheses of which nothing is known"""


def average(x: Array, P: Array, wheels: int, landmarks: int, options: FilterOptions) -> tuple[Array, Array]:
    """Return mean (n,) and covariance (n, n) over the hypotheses.

    Args:
        x: mean (n,) of the filter's states.
        P: their covariance (n, n).
        wheels: place of the first error of the wheels in the state.
        landmarks: place of the first error of the landmarks' sensor.
        options: of the filter; what is no state there has the variance 0 at the start.
    """
    x, P = average_over(x, P, wheels, options.wheel_errors, wheel_variances(options), options.wheels_as_configured)
    variances = landmark_variances(options)
    return average_over(x, P, landmarks, options.landmark_errors, variances, EVEN) if any(variances) else (x, P)


def wheel_variances(options: FilterOptions) -> Three:
    """Return the variances of the wheels' errors at the start."""
    return options.radius_variance, options.radius_variance, options.separation_variance


def landmark_variances(options: FilterOptions) -> Three:
    """Return the variances of the errors of the landmarks' sensor at the start; all 0: they are no states."""
    offset, scale, bearing = options.landmark_sigmas
    return offset * offset, scale * scale, bearing * bearing


def average_over(
    x: Array, P: Array, first: int, configured: Three, variances: Three, prior: float
) -> tuple[Array, Array]:
    """Return mean (n,) and covariance (n, n) over both hypotheses on the errors from the place ``first`` on.

    ``configured`` is what they are under the one, whose probability at the start is ``prior``; ``variances`` are theirs
    at the start under the other; 0: no state.
    """
    given, P_given, log_ratio = x.copy(), P.copy(), 0.0
    for i in range(3):
        at = first + i
        if variances[i] > 0.0 and P_given[at, at] > 0.0:
            variance, shift = P_given[at, at], configured[i] - given[at]
            log_ratio += log_density_ratio(shift, variance, variances[i])
            gain = P_given[at] / variance
            given += gain * shift
            P_given -= np.outer(gain, variance * gain)
    as_configured = probability(log_ratio, prior)
    between = given - x
    mean = x + as_configured * between
    mean[2] = wrap_angle(mean[2])
    spread = as_configured * (1.0 - as_configured) * np.outer(between, between)
    return mean, P + as_configured * (P_given - P) + spread


def log_density_ratio(shift: float, variance: float, variance_before: float) -> float:
    """Return the logarithm of the density of an error at its configured value over that at the start.

    Args:
        shift: configured value minus mean.
        variance: of the error.
        variance_before: at the start, when the configured value was the mean.
    """
    return 0.5 * (math.log(variance_before / variance) - shift * shift / variance)


def probability(log_ratio: float, prior: float) -> float:
    """Return the probability of a hypothesis.

    Args:
        log_ratio: logarithm of how much more likely it has become than the other one.
        prior: its probability at the start.
    """
    return prior / (prior + (1.0 - prior) * math.exp(min(-log_ratio, 700.0)))
