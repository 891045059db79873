"""Omega_G and Omega_L: the paper's condition, hysteresis, and a radius that follows the covariance."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from diffbot_control.law.regions import (
    OMEGA_G,
    OMEGA_L,
    CovarianceRegionPolicy,
    FixedRegionPolicy,
    covariance_radius,
    covariance_region,
    fixed_region,
    smallest_radius,
)

POLICY = FixedRegionPolicy(0.5, 0.6)


def test_the_papers_condition():
    # sqrt(0.3^2 + 0.3^2) + 0.065 / 1.3 = 0.42426 + 0.05.
    assert smallest_radius(0.3, 0.3, 0.065, 1.3) == pytest.approx(0.474264, abs=1e-6)
    # 3-4-5: 0.5 + 0.2 / 2.
    assert smallest_radius(0.3, 0.4, 0.2, 2.0) == pytest.approx(0.6)
    assert FixedRegionPolicy().eps_P > smallest_radius(0.3, 0.3, 0.065, 1.3)


@pytest.mark.parametrize(
    ("before", "rho", "after"),
    [
        (OMEGA_G, 0.55, OMEGA_G),
        (OMEGA_G, 0.5, OMEGA_G),
        (OMEGA_G, math.nextafter(0.5, 0.0), OMEGA_L),
        (OMEGA_L, 0.55, OMEGA_L),
        (OMEGA_L, 0.6, OMEGA_L),
        (OMEGA_L, math.nextafter(0.6, 1.0), OMEGA_G),
        # A distance that is no number must not count as near.
        (OMEGA_L, math.nan, OMEGA_G),
        (OMEGA_G, math.nan, OMEGA_G),
    ],
)
def test_hysteresis(before, rho, after):
    assert fixed_region(before, rho, POLICY) == after


CHECK = settings(max_examples=100)
COVARIANCE_POLICY = CovarianceRegionPolicy(0.02, 2.2, 0.05, 3.0, 0.3, 3)
DISTANCES = st.floats(0.0, 100.0)
SIGMAS = st.floats(0.0, 10.0)


@CHECK
@given(DISTANCES, SIGMAS, st.floats(0.1, 10.0), st.floats(0.0, 1.0), st.floats(0.0, 5.0))
def test_radius_is_the_bound_of_the_paper_with_the_errors_of_now(rho, sigma, gamma, share, sigmas):
    policy = COVARIANCE_POLICY._replace(eps_P_min=0.0, eps_P_speed_error=share, eps_P_sigmas=sigmas)
    # An error of that many standard deviations in any direction, and a share of the speed gamma tanh(rho).
    for direction in (0.0, 0.7, 2.0):
        eps_x, eps_y = sigmas * sigma * math.cos(direction), sigmas * sigma * math.sin(direction)
        bound = smallest_radius(eps_x, eps_y, share * gamma * math.tanh(rho), gamma)
        assert covariance_radius(rho, sigma, policy) == pytest.approx(bound, rel=1e-12, abs=1e-300)
    least = 0.3 + share * math.tanh(rho)
    assert covariance_radius(rho, 0.0, policy._replace(eps_P_min=0.3)) == pytest.approx(least)


@CHECK
@given(st.lists(st.tuples(DISTANCES, SIGMAS), min_size=1, max_size=60), st.sampled_from((OMEGA_G, OMEGA_L)))
def test_the_count_agrees_with_a_search_of_the_whole_sequence(pairs, region):
    """Omega_L ends where the last three are all beyond their own leaving radii, all of them since it was entered."""
    found, outside, regions = region, 0, []
    for rho, sigma in pairs:
        found, outside, _ = covariance_region(found, outside, rho, sigma, COVARIANCE_POLICY)
        regions.append(found)

    def radius(rho, sigma):
        return max(0.02, 2.2 * sigma) + 0.05 * (1.0 - 2.0 / (math.exp(2.0 * min(rho, 40.0)) + 1.0))

    inside_since = -1 if region == OMEGA_L else None
    for index, (rho, sigma) in enumerate(pairs):
        if abs(rho - radius(rho, sigma)) < 1e-9 or abs(rho - max(3.0 * radius(rho, sigma), 0.3)) < 1e-9:
            return
        if inside_since is None:
            if rho < radius(rho, sigma):
                inside_since = index
        else:
            last = pairs[max(inside_since + 1, index - 2) : index + 1]
            if len(last) == 3 and all(r > max(3.0 * radius(r, s), 0.3) for r, s in last):
                inside_since = None
        assert regions[index] == (OMEGA_G if inside_since is None else OMEGA_L)
