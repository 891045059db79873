"""Omega_G and Omega_L: the radius that follows the estimate, and when the robot approaches the goal again."""

import math

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from diffbot_control.law.goal_checker import GoalTolerance
from diffbot_control.law.regions import OMEGA_G, OMEGA_L, Switching, SwitchInput, next_switching
from diffbot_core.data_sheet import DataSheet
from diffbot_core.kinematics import Twist
from diffbot_core.uncertainty import Uncertainty

TOLERANCE, SHEET = GoalTolerance(), DataSheet()
REST = Twist(0.0, 0.0)


def after(before, rho, sigma, *, theta=0.0, command=REST, reached=False, dt=0.1):
    standing = SwitchInput(rho, theta, command, reached)
    return next_switching(before, standing, Uncertainty(sigma, 0.01), dt, TOLERANCE, SHEET)


@given(st.floats(0.0, 2.0), st.floats(0.0, 1.0))
def test_omega_l_is_entered_within_one_deviation_and_left_beyond_three_and_the_tolerance(rho, sigma):
    entering = max(0.02, sigma)
    leaving = max(3.0 * entering, 0.1)
    assume(min(abs(rho - entering), abs(rho - leaving)) > 1e-12)  # 0.2 * 0.1 is not 0.02
    moving = Twist(0.5, 0.0)
    far, radius = after(Switching(OMEGA_G, 4, 0.0), rho, sigma, command=moving)
    assert far == (Switching(OMEGA_L, 5, 0.0) if rho < entering else Switching(OMEGA_G, 4, 0.0))
    assert radius == pytest.approx(leaving if rho < entering else entering)
    near, radius = after(Switching(OMEGA_L, 5, 0.3), rho, sigma, command=moving)
    assert near == (Switching(OMEGA_G, 6, 0.0) if rho > leaving else Switching(OMEGA_L, 5, 0.0))
    assert radius == pytest.approx(entering if rho > leaving else leaving)


@pytest.mark.parametrize("region", [OMEGA_G, OMEGA_L])
def test_a_distance_that_is_not_a_number_does_not_change_the_region(region):
    assert after(Switching(region, 3, 0.0), math.nan, 0.02)[0].region == region


def rested(rho, sigma, seconds=5.0, **standing):
    """Return the time [s] at rest after which Omega_L ends; inf if it does not within ``seconds``."""
    switching = Switching(OMEGA_L, 1, 0.0)
    for step in range(round(seconds / 0.1)):
        switching, _ = after(switching, rho, sigma, **standing)
        if switching.region == OMEGA_G:
            return pytest.approx(0.1 * (step + 1))
    return math.inf


def test_a_robot_at_rest_with_a_significant_error_approaches_again_after_a_second():
    # 0.085 m from the goal with 1 cm: 7 % of the possible positions are outside 0.1 m.
    assert rested(0.085, 0.01) in (pytest.approx(1.0), pytest.approx(1.1))
    # With 1 % outside, or with 0.5 cm, the goal is reached or will soon be.
    assert rested(0.07, 0.01) == math.inf
    assert rested(0.085, 0.005) == math.inf
    assert rested(0.085, 0.01, reached=True) == math.inf
    # If the estimate is too uncertain even at the goal, driving does not help.
    assert rested(0.085, 0.05) == math.inf
    # A robot that moves, or whose heading is off, is not at rest.
    assert rested(0.085, 0.01, command=Twist(0.06, 0.0)) == math.inf
    assert rested(0.085, 0.01, command=Twist(0.0, 0.11)) == math.inf
    assert rested(0.085, 0.01, theta=0.11) == math.inf


def test_the_time_at_rest_counts_in_a_row():
    switching = Switching(OMEGA_L, 1, 0.0)
    for step in range(200):
        moving = step % 9 == 8
        switching, _ = after(switching, 0.085, 0.01, command=Twist(0.1, 0.0) if moving else REST)
        assert switching.region == OMEGA_L
