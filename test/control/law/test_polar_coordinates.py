"""Navigation variables and their models, against complex numbers and the exact motion of the robot."""

import cmath
import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from diffbot_control.law.polar_coordinates import (
    Navigation,
    discrete_model,
    in_front,
    navigation_variables,
)
from diffbot_core.geometry import Pose, wrap_angle

CHECK = settings(max_examples=150)
POSES = st.builds(Pose, st.floats(-50.0, 50.0), st.floats(-50.0, 50.0), st.floats(-math.pi, math.pi))


def moved(pose, v, omega, time):
    """Return the pose after driving with a constant twist: the closed form of Eq. (1), for omega not 0."""
    x, y, theta = pose
    end = theta + omega * time
    radius = v / omega
    return Pose(
        x + radius * (math.sin(end) - math.sin(theta)),
        y - radius * (math.cos(end) - math.cos(theta)),
        end,
    )


def phase(number):
    """As cmath.phase, which refuses results that are subnormal."""
    return math.atan2(number.imag, number.real)


def difference(one, other):
    return np.array(
        [
            one.rho - other.rho,
            wrap_angle(one.alpha - other.alpha),
            wrap_angle(one.beta - other.beta),
        ]
    )


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


def test_the_front_sector_is_half_open():
    assert in_front(math.pi / 2)
    assert not in_front(math.nextafter(math.pi / 2, 2.0))
    assert in_front(math.nextafter(-math.pi / 2, 0.0))
    assert not in_front(-math.pi / 2)


def test_the_model_wraps_its_angles():
    step = discrete_model(Navigation(1.0, 3.1, 3.1), 1.0, -1.0, 0.1)
    # alpha in the rear sector: 3.1 - 0.1 sin(3.1) + 0.1 = 3.19584 - 2 pi.
    assert step.alpha == pytest.approx(3.1 - 0.1 * math.sin(3.1) + 0.1 - 2.0 * math.pi)
    assert discrete_model(Navigation(0.1, 1.0, 3.1), 1.0, 0.0, 0.1).beta == pytest.approx(
        3.1 + math.sin(1.0) - 2.0 * math.pi
    )


def states(count):
    """Return poses all around the goal, with speeds along the real axis and noise."""
    rng = np.random.default_rng(11)
    for _ in range(count):
        distance, bearing, theta = (
            rng.uniform(1.0, 6.0),
            rng.uniform(-3.1, 3.1),
            rng.uniform(-3.1, 3.1),
        )
        pose = Pose(distance * math.cos(bearing), distance * math.sin(bearing), theta)
        yield pose, rng.uniform(0.2, 1.3), rng.uniform(0.2, 1.0)


@pytest.mark.parametrize(("eps_v", "eps_omega"), [(0.0, 0.0), (0.065, -0.1)])
@pytest.mark.parametrize("front", [True, False])
def test_the_model_is_the_real_motion_to_first_order(front, eps_v, eps_omega):
    # Halving the sampling time has to quarter the error of one step: the signature of a first-order model.
    tried = 0
    for pose, v, omega in states(200):
        now = navigation_variables(pose)
        if in_front(now.alpha) is not front:
            continue
        tried += 1
        # The paper turns the forward direction round in the rear sector, v and its noise alike.
        real_v = (v + eps_v) if front else -(v + eps_v)
        errors = []
        for t_s in (2e-3, 1e-3):
            exact = navigation_variables(moved(pose, real_v, omega + eps_omega, t_s))
            model = discrete_model(now, v, omega, t_s, eps_v, eps_omega)
            errors.append(np.linalg.norm(difference(model, exact)))
        assert errors[0] < 1e-5
        assert 3.9 < errors[0] / errors[1] < 4.1
    assert tried > 50
