"""The average over both hypotheses on the estimated errors, against linear measurements and their evidence."""

import numpy as np
import pytest
from filter_runs import covariance
from scipy.stats import multivariate_normal

from diffbot_control.filter.averaging import average, average_over
from diffbot_control.filter.options import FilterConfig, options_of

RADIUS, SEPARATION = 0.05, 0.1


def posterior(prior, P, H, z, R):
    """Return mean, covariance and the density of all measurements ``z`` at once."""
    S = H @ P @ H.T + R
    K = P @ H.T @ np.linalg.inv(S)
    return prior + K @ (z - H @ prior), P - K @ S @ K.T, multivariate_normal.pdf(z, H @ prior, S)


@pytest.mark.parametrize("prior", [0.0, 0.2, 0.5, 1.0])
@pytest.mark.parametrize("first", [3, 4])
@pytest.mark.parametrize("deviation", [0.0, 1.0, 3.0])
def test_it_is_the_mixture_of_both_posteriors_by_their_evidence(first, deviation, prior):
    rng = np.random.default_rng(round(10 * deviation) + first)
    n, errors = first + 3, slice(first, first + 3)
    configured, variances = np.array([0.3, -0.2, 0.1]), np.array([0.04, 0.01, 0.09])
    prior, P = np.zeros(n), covariance(rng, n)
    P[errors, :] = P[:, errors] = 0.0
    prior[errors], P[errors, errors] = configured, np.diag(variances)
    known = P.copy()
    known[errors, errors] = 0.0
    H, R = rng.normal(size=(8, n)), covariance(rng, 8, 0.1, 0.3)
    true = rng.multivariate_normal(prior, known)
    true[errors] += deviation * np.sqrt(variances)
    z = rng.multivariate_normal(H @ true, R)
    x, P_x, evidence = posterior(prior, P, H, z, R)
    other, P_other, other_evidence = posterior(prior, known, H, z, R)
    w = prior * other_evidence / ((1.0 - prior) * evidence + prior * other_evidence)
    mean = w * other + (1.0 - w) * x
    spread = sum(one * np.outer(at - mean, at - mean) for one, at in ((w, other), (1.0 - w, x)))
    found, P_found = average_over(x, P_x, first, tuple(configured), tuple(variances), prior)
    np.testing.assert_allclose(found, mean, atol=1e-9)
    np.testing.assert_allclose(P_found, w * P_other + (1.0 - w) * P_x + spread, atol=1e-9)


def test_wheels_and_landmarks_have_hypotheses_of_their_own():
    rng = np.random.default_rng(0)
    config = FilterConfig(
        wheel_radius_sigma=RADIUS, wheel_separation_sigma=SEPARATION, left_radius_error=0.01, wheels_as_configured=0.3
    )
    options = options_of(config, landmarks=True)
    x, P = rng.normal(0.0, 1e-3, 9), covariance(rng, 9, 1e-3, 1e-2)
    wheels = average_over(x, P, 3, (0.01, 0.0, 0.0), (RADIUS**2, RADIUS**2, SEPARATION**2), 0.3)
    both = average_over(*wheels, 6, (0.0, 0.0, 0.0), (0.05**2, 0.01**2, 0.01**2), 0.5)
    for found, expected in zip(average(x, P, 3, 6, options), both, strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-12)
    without = average(x[:6], P[:6, :6], 3, 6, options_of(config))
    np.testing.assert_allclose(without[0], wheels[0][:6], rtol=1e-12)


def test_what_is_no_state_is_not_averaged():
    rng = np.random.default_rng(1)
    x, P = rng.normal(size=5), covariance(rng, 5)
    found, P_found = average(x, P, 3, 5, options_of(FilterConfig(filter="ekf")))
    np.testing.assert_array_equal(found, x)
    np.testing.assert_array_equal(P_found, P)


def test_the_heading_stays_within_half_a_turn():
    P = np.diag([1.0, 1.0, 1.0, 0.01])
    P[2, 3] = P[3, 2] = 0.05
    found, _ = average_over(np.array([0.0, 0.0, 3.14, -0.1]), P, 3, (0.0, 0.0, 0.0), (0.01, 0.0, 0.0), 0.5)
    assert -np.pi < found[2] < -2.9
