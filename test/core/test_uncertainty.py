"""Probabilities that a pose is within a tolerance, against the distributions of scipy."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import ncx2, norm

from diffbot_core.uncertainty import disc_probability, interval_probability, largest_deviation

CHECK = settings(max_examples=100)
SIGMAS = st.floats(-4.0, 2.0).map(lambda exponent: 10.0**exponent)
"""[m] or [rad]"""
IN_SIGMAS = st.floats(-2.0, 3.0).map(lambda exponent: 10.0**exponent)
"""radius or bound in standard deviations"""
BEYOND = st.floats(-12.0, 12.0)
"""distance of the mean from the bound in standard deviations"""


@CHECK
@given(SIGMAS, IN_SIGMAS, BEYOND, st.booleans())
def test_the_probability_of_a_disc_is_the_noncentral_chi_square_distribution(sigma, radius, beyond, at_the_centre):
    offset = 0.0 if at_the_centre else max(radius + beyond, 0.0)
    found = disc_probability(offset * sigma, sigma, radius * sigma)
    # scipy's series is not defined at an offset of 0.
    expected = ncx2.cdf(radius**2, 2, offset**2) if offset > 1e-6 else -math.expm1(-0.5 * radius**2)
    assert found == pytest.approx(expected, abs=1e-5)
    assert 0.0 <= found <= 1.0


@CHECK
@given(SIGMAS, IN_SIGMAS, BEYOND, st.sampled_from((-1.0, 1.0)))
def test_the_probability_of_an_interval_is_the_normal_distribution(sigma, bound, beyond, side):
    offset = side * (bound + beyond)
    expected = norm.cdf(bound - offset) - norm.cdf(-bound - offset)
    assert interval_probability(offset * sigma, sigma, bound * sigma) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("probability", [disc_probability, interval_probability])
def test_an_exact_estimate_has_the_probability_0_or_1_and_nan_is_never_inside(probability):
    assert probability(0.1, 0.0, 0.1) == 1.0
    assert probability(math.nextafter(0.1, 1.0), 0.0, 0.1) == 0.0
    assert probability(0.05, 1e-300, 0.1) == 1.0
    assert probability(0.0, math.inf, 0.1) == 0.0
    for args in ((math.nan, 0.1, 0.1), (0.0, math.nan, 0.1), (math.nan, 0.0, 0.1)):
        assert not probability(*args) > 0.0


@settings(max_examples=100)
@given(st.floats(1e-4, 1e3), st.floats(1e-4, 1e3), st.floats(-math.pi, math.pi))
def test_the_largest_deviation_is_the_longer_axis_of_the_error_ellipse(one, other, turn):
    c, s = math.cos(turn), math.sin(turn)
    rotation = np.array([[c, -s], [s, c]])
    P = rotation @ np.diag([one**2, other**2]) @ rotation.T
    assert largest_deviation(P[0, 0], P[0, 1], P[1, 1]) == pytest.approx(max(one, other), rel=1e-9)


def test_the_largest_deviation_of_a_singular_covariance_is_finite():
    assert largest_deviation(1.0, -1.0, 1.0) == pytest.approx(math.sqrt(2.0))
    assert largest_deviation(-1e-20, 0.0, -1e-20) == 0.0
