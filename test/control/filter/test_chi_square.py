"""Chi-square bounds against scipy's."""

import pytest
from scipy.special import chdtrc, chdtri

from diffbot_control.filter.chi_square import chi_square_bound, survival

DEGREES = (1, 2, 3, 10, 99, 150)
TAILS = (0.999, 0.975, 0.5, 0.025, 1e-3, 1e-4, 1e-9, 1e-15)


@pytest.mark.parametrize("dof", DEGREES)
def test_bounds_are_those_of_scipy(dof):
    for tail in TAILS:
        # Rounding of a probability near 1 is large relative to the small bound.
        assert chi_square_bound(dof, tail) == pytest.approx(float(chdtri(dof, tail)), rel=1e-12)


@pytest.mark.parametrize("dof", DEGREES)
def test_probabilities_are_those_of_scipy(dof):
    for x in (0.0, 1e-6, 0.3, 1.0, float(dof), 3.0 * dof, 700.0):
        assert survival(x, dof) == pytest.approx(float(chdtrc(dof, x)), rel=1e-12, abs=1e-300)
