"""When a goal counts as reached: at rest, and within the tolerances by probability."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import norm, rayleigh

from diffbot_control.law.goal_checker import GoalTolerance, is_knowable, is_off, smallest_tolerance, within
from diffbot_core.data_sheet import DataSheet
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist
from diffbot_core.uncertainty import CERTAIN, Uncertainty

TOLERANCE = GoalTolerance(0.4, 0.1, reached_probability=0.95)
SHEET = DataSheet()


def is_within(rho=0.4, theta=0.1, v=0.05, omega=0.1, sheet=SHEET, uncertainty=CERTAIN):
    return within(Pose(9.0, 9.0, theta), rho, Twist(v, omega), TOLERANCE, sheet, uncertainty)


@pytest.mark.parametrize(("name", "value"), [("rho", 0.4), ("theta", 0.1), ("v", 0.05), ("omega", 0.1)])
def test_each_bound_alone_decides(name, value):
    assert not is_within(**{name: math.nextafter(value, 1.0)})
    if name != "rho":
        assert not is_within(**{name: -math.nextafter(value, 1.0)})
    assert not is_within(**{name: math.nan})


def test_commands_up_to_the_dead_band_count_as_rest():
    pulses = SHEET._replace(min_velocity=0.08, min_rotation=0.3)
    assert is_within(v=0.08, omega=-0.3, sheet=pulses)
    assert not is_within(v=0.081, sheet=pulses)
    assert not is_within(omega=0.301, sheet=pulses)


def test_a_goal_is_reached_if_enough_of_the_possible_poses_are_within_the_tolerances():
    rng, found = np.random.default_rng(3), set()
    x, y, turn = rng.normal(size=(3, 200_000))
    for _ in range(60):
        rho, theta = rng.uniform(0.0, 0.4), rng.uniform(-0.1, 0.1)
        sigma = Uncertainty(rng.uniform(0.0, 0.2), rng.uniform(0.0, 0.06))
        share = np.mean((np.hypot(rho + sigma.xy * x, sigma.xy * y) <= 0.4) & (abs(theta + sigma.theta * turn) <= 0.1))
        if abs(share - 0.95) > 0.004:  # eight standard errors of the share
            inside_tolerances = is_within(rho, theta, 0.0, 0.0, uncertainty=sigma)
            assert inside_tolerances == (share > 0.95)
            found.add(inside_tolerances)
    assert found == {True, False}


@settings(max_examples=100)
@given(st.floats(0.5, 0.9999), st.floats(1e-4, 1.0), st.floats(1e-4, 1.0))
def test_the_smallest_tolerance_is_just_knowable(probability, xy, turn):
    sigma = Uncertainty(xy, turn)
    length, angle = smallest_tolerance(TOLERANCE._replace(reached_probability=probability), sigma)
    assert rayleigh.cdf(length / xy) == pytest.approx(probability, abs=1e-9)
    assert norm.cdf(angle / turn) - norm.cdf(-angle / turn) == pytest.approx(probability, abs=1e-9)
    for share in (0.99, 1.01):
        asked = TOLERANCE._replace(reached_probability=probability)
        position = asked._replace(xy_goal_tolerance=share * length)
        assert is_knowable(position, Uncertainty(xy, 0.0)) == (share > 1.0)
        heading = asked._replace(yaw_goal_tolerance=share * angle)
        assert is_knowable(heading, Uncertainty(0.0, turn)) == (share > 1.0)


def test_an_error_is_significant_if_too_few_of_the_possible_positions_are_inside_but_enough_would_be_at_the_goal():
    rng = np.random.default_rng(5)
    x, y = rng.normal(size=(2, 400_000))
    for rho, sigma in ((0.2, 0.05), (0.27, 0.05), (0.31, 0.05), (0.05, 0.16), (0.1, 0.2), (0.4, 1e-4)):
        inside = np.mean(np.hypot(rho + sigma * x, sigma * y) <= 0.4)
        at_the_goal = np.mean(np.hypot(sigma * x, sigma * y) <= 0.4)
        # Three times the 5 % that may be outside.
        assert abs(inside - 0.85) > 0.003
        assert abs(at_the_goal - 0.95) > 0.002
        assert is_off(rho, TOLERANCE, Uncertainty(sigma, 0.0)) == (inside < 0.85 and at_the_goal > 0.95)
