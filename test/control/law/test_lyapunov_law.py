"""The laws near the goal, against their eigenvalues, and their series of sin(x) / x and tanh(x) / x."""

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from diffbot_control.law.lyapunov_law import PAPER_GAINS, Gains, global_law, local_law, sinc, tanhc
from diffbot_control.law.polar_coordinates import Navigation


def near_the_goal(gains):
    """State matrices of the angles in Omega_G, of the distance and of the heading in Omega_L, for small ones.

    From the laws themselves, by differences, with the kinematics alpha' = v sin(alpha) / rho - omega,
    beta' = v sin(alpha) / rho, rho' = -v cos(alpha).
    """
    rho, small = 1e-6, 1e-6

    def rates(alpha, beta):
        v, omega = global_law(Navigation(rho, alpha, beta), gains)
        turn = v * math.sin(alpha) / rho
        return np.array([turn - omega, turn])

    columns = [(rates(*step) - rates(*(-step))) / (2.0 * small) for step in small * np.eye(2)]
    v, _ = global_law(Navigation(rho, 0.0, 0.0), gains)
    _, omega = local_law(Navigation(rho, 0.0, 0.0), small, gains)
    return np.column_stack(columns), np.array([[-v / rho]]), np.array([[omega / small]])


@pytest.mark.parametrize("gains", [Gains(), PAPER_GAINS])
def test_the_poles_near_the_goal_are_those_of_the_linearised_laws(gains):
    angles, distance, heading = (np.linalg.eigvals(A) for A in near_the_goal(gains))
    # The roots of s^2 + k s + gamma^2 h, whose sum and product rounding hurts less than themselves at a double pole.
    assert [angles.sum(), angles.prod()] == pytest.approx([-gains.k, gains.gamma**2 * gains.h], rel=1e-6)
    assert [*distance, *heading] == pytest.approx([-gains.gamma, -gains.k_2], rel=1e-6)


@settings(max_examples=150)
@given(st.floats(1e-8, 1e-2))
def test_sinc_and_tanhc_against_exact_series(x):
    # Taylor series in exact fractions; the rest is below x^8 = 1e-16 of the value.
    square = Fraction(x) ** 2
    sine = 1 - square / 6 + square**2 / 120 - square**3 / 5040
    tangent = 1 - square / 3 + 2 * square**2 / 15 - 17 * square**3 / 315
    assert sinc(x) == pytest.approx(float(sine), rel=3e-16)
    assert tanhc(x) == pytest.approx(float(tangent), rel=3e-16)
    assert sinc(-x) == sinc(x)
    assert tanhc(-x) == tanhc(x)
    assert sinc(0.0) == tanhc(0.0) == 1.0
