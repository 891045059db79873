"""Navigation variables, against complex numbers."""

import cmath
import math

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from diffbot_control.law.polar_coordinates import navigation_variables
from diffbot_core.geometry import Pose, wrap_angle

CHECK = settings(max_examples=150)
POSES = st.builds(Pose, st.floats(-50.0, 50.0), st.floats(-50.0, 50.0), st.floats(-math.pi, math.pi))


def phase(number):
    """As cmath.phase, which refuses results that are subnormal."""
    return math.atan2(number.imag, number.real)


@CHECK
@given(POSES)
def test_variables_against_complex_numbers(pose):
    to_goal = -complex(pose.x, pose.y)
    assume(abs(to_goal) > 1e-9)
    rho, alpha, beta = navigation_variables(pose)
    assert rho == pytest.approx(abs(to_goal), rel=1e-12)
    # The goal in the robot's frame, and in the goal's: phases of the same vector, turned by theta and not.
    assert wrap_angle(beta - phase(to_goal)) == pytest.approx(0.0, abs=1e-9)
    in_robot = to_goal * cmath.exp(-1j * pose.theta)
    assert wrap_angle(alpha - phase(in_robot)) == pytest.approx(0.0, abs=1e-9)
    assert -math.pi < alpha <= math.pi
    assert -math.pi < beta <= math.pi
    assert wrap_angle(beta - alpha - pose.theta) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("zero", [0.0, -0.0])
def test_the_sign_of_zero_does_not_turn_the_bearing(zero):
    assert navigation_variables(Pose(-0.0, zero, 0.3)) == (0.0, -0.3, 0.0)
    # atan2 itself gives -pi straight behind; the interval is (-pi, pi].
    assert navigation_variables(Pose(2.0, zero, 0.0))[1:] == (math.pi, math.pi)
