"""Omega_G and Omega_L: radii, hysteresis and the paper's condition."""

import math

import pytest

from diffbot_control.law.regions import (
    OMEGA_G,
    OMEGA_L,
    FixedRegionPolicy,
    fixed_region,
    smallest_radius,
)
from diffbot_core.errors import InvalidValueError

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
        (OMEGA_G, 0.6, OMEGA_G),
        (OMEGA_G, 0.55, OMEGA_G),
        (OMEGA_G, 0.5, OMEGA_G),
        (OMEGA_G, math.nextafter(0.5, 0.0), OMEGA_L),
        (OMEGA_G, 0.0, OMEGA_L),
        (OMEGA_L, 0.0, OMEGA_L),
        (OMEGA_L, 0.55, OMEGA_L),
        (OMEGA_L, 0.6, OMEGA_L),
        (OMEGA_L, math.nextafter(0.6, 1.0), OMEGA_G),
        (OMEGA_L, 100.0, OMEGA_G),
        # A distance that is no number must not count as near.
        (OMEGA_L, math.nan, OMEGA_G),
        (OMEGA_G, math.nan, OMEGA_G),
    ],
)
def test_hysteresis(before, rho, after):
    assert fixed_region(before, rho, POLICY) == after


def test_a_leaving_radius_below_the_entering_one_is_refused():
    with pytest.raises(InvalidValueError, match=r"eps_P_leave = 0\.4: must be >= eps_P = 0\.5"):
        FixedRegionPolicy(0.5, 0.4).check()
    FixedRegionPolicy(0.5, 0.5).check()
    FixedRegionPolicy().check()
