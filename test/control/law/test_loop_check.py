"""The warning of gains that cannot be stable, against eigenvalues and driven loops; sinc and tanhc of the laws."""

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from diffbot_control.law.loop_check import largest_gain, unstable_gains
from diffbot_control.law.lyapunov_law import Gains, global_law, local_law, sinc, tanhc
from diffbot_control.law.polar_coordinates import Navigation
from diffbot_control.law.presets import PRESETS
from diffbot_core.data_sheet import PAPER_DATA_SHEET

PAPER = PRESETS["paper"]
TUNED = PRESETS["tuned"]
FAST = PAPER._replace(gains=Gains())
GAINS = st.builds(Gains, st.floats(0.1, 5.0), st.floats(0.1, 10.0), st.floats(0.01, 10.0), st.floats(0.1, 10.0))


def test_gains_that_are_not_are_named_in_one_line():
    text = unstable_gains(PAPER._replace(gains=Gains(30.0, 100.0, 0.001, 100.0)), 0.1)
    assert text == (
        "gains are not stable at 0.1 s per step, eigenvalues must be inside the unit circle: "
        "k, h and gamma (angles in Omega_G): 9.00, gamma (distance): 2.00, k_2 (heading in Omega_L): 9.00"
    )


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


@settings(max_examples=100)
@given(GAINS, st.floats(0.001, 3.0))
def test_the_warning_comes_exactly_when_an_eigenvalue_of_a_step_is_not_inside_the_circle(gains, t_s):
    sizes = [np.abs(np.linalg.eigvals(np.eye(len(A)) + t_s * A)).max() for A in near_the_goal(gains)]
    # At a double pole the square root makes much of the differences' rounding.
    assume(all(abs(size - 1.0) > 2e-4 * (1.0 + t_s) for size in sizes))
    assert (unstable_gains(PAPER._replace(gains=gains), t_s) == "") is all(size < 1.0 for size in sizes)


def driven(gain, delay, steps=4000):
    """x(n+1) = x(n) - gain x(n - delay) from 1: the largest size of the last tenth."""
    past = [1.0] * (delay + 1)
    for _ in range(steps):
        past.append(past[-1] - gain * past[-1 - delay])
    return max(abs(one) for one in past[-steps // 10 :])


@pytest.mark.parametrize("delay", [0, 1, 3, 8])
def test_the_largest_gain_with_a_delay_separates_loops_that_settle_from_those_that_grow(delay):
    bound = largest_gain(delay)
    assert driven(0.97 * bound, delay) < 0.5
    assert driven(1.03 * bound, delay) > 2.0


@pytest.mark.parametrize(("latency", "lag", "warned"), [(0.2, 0.0, False), (0.3, 0.0, True), (0.15, 0.1, True)])
def test_the_papers_law_with_fast_gains_is_warned_of_where_it_spins(latency, lag, warned):
    sheet = PAPER_DATA_SHEET._replace(command_latency=latency, drive_time_constant=lag)
    text = unstable_gains(FAST._replace(data_sheet=sheet), 0.1)
    assert bool(text) is warned
    if warned:
        assert "k + gamma (angles in Omega_G): 0.53 per step, must be below 0.45 with 3 steps" in text
    # Known, it is predicted: the default law has no delay left in its loop.
    assert unstable_gains(TUNED._replace(data_sheet=sheet), 0.1) == ""


@pytest.mark.parametrize(
    ("a_max", "omega_dot_max", "names"),
    [(math.inf, 1.5, "k: with angular.z"), (0.5, math.inf, "gamma: braking takes 0.65 m/s^2"), (0.7, 40.0, "")],
)
def test_the_papers_law_is_warned_of_where_it_cannot_brake(a_max, omega_dot_max, names):
    sheet = PAPER_DATA_SHEET._replace(a_max=a_max, omega_dot_max=omega_dot_max)
    text = unstable_gains(FAST._replace(data_sheet=sheet), 0.1)
    assert names in text
    assert bool(text) is bool(names)
    assert unstable_gains(TUNED._replace(data_sheet=sheet), 0.1) == ""


def test_profiles_too_steep_for_the_sampling_time_are_named():
    gains = TUNED.profile_gains._replace(hold_react=0.04)
    text = unstable_gains(TUNED._replace(profile_gains=gains), 0.1)
    assert "hold_react (heading in Omega_L): 2.50 per step, must be below 2.00" in text
    assert unstable_gains(TUNED, 0.1) == unstable_gains(TUNED, 0.3) == ""
    # Automatic gains follow the sampling time.
    assert unstable_gains(TUNED._replace(gain_source=1), 3.0) == ""


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
