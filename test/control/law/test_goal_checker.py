"""When a goal counts as reached: each tolerance on its own."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from diffbot_control.filter.covariance import uncertainty_of
from diffbot_control.law.goal_checker import GoalTolerance, is_knowable, within
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist
from diffbot_core.uncertainty import Uncertainty, largest_deviation

TOLERANCE = GoalTolerance(0.4, 0.1, 0.05, 0.2, goal_sigmas=2.0)


def judged(rho=0.4, theta=0.1, v=0.05, omega=0.2):
    return within(Pose(9.0, 9.0, theta), rho, Twist(v, omega), TOLERANCE)


def test_the_bounds_belong_to_the_inside():
    assert judged()
    assert judged(theta=-0.1, v=-0.05, omega=-0.2)
    assert judged(0.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize(("name", "value"), [("rho", 0.4), ("theta", 0.1), ("v", 0.05), ("omega", 0.2)])
def test_each_bound_alone_decides(name, value):
    assert not judged(**{name: math.nextafter(value, 1.0)})
    if name != "rho":
        assert not judged(**{name: -math.nextafter(value, 1.0)})
    assert not judged(**{name: math.nan})


@pytest.mark.parametrize(
    ("rho", "theta", "xy", "turn", "inside"),
    [
        # 0.4 m and 0.1 rad, less two deviations each.
        (0.3, -0.05, 0.049, 0.024, True),
        (0.3, -0.05, 0.051, 0.024, False),
        (0.3, -0.05, 0.049, 0.026, False),
        (0.0, 0.0, 0.21, 0.0, False),
        (0.4, 0.1, 0.0, 0.0, True),
    ],
)
def test_two_deviations_are_added_to_each_error(rho, theta, xy, turn, inside):
    assert within(Pose(9.0, 9.0, theta), rho, Twist(0.0, 0.0), TOLERANCE, Uncertainty(xy, turn)) is inside


@pytest.mark.parametrize(
    ("xy", "theta", "knowable"),
    [
        (0.19, 0.04, True),
        (0.2, 0.0, False),
        (0.0, 0.05, False),
        (math.inf, 0.0, False),
        (0.0, math.nan, False),
    ],
)
def test_an_estimate_can_be_inside_if_two_deviations_fit_into_the_tolerances(xy, theta, knowable):
    assert is_knowable(TOLERANCE, Uncertainty(xy, theta)) is knowable


@settings(max_examples=100)
@given(st.floats(1e-4, 1e3), st.floats(1e-4, 1e3), st.floats(-math.pi, math.pi))
def test_largest_deviation_is_the_longer_axis_of_the_ellipse(one, other, turn):
    c, s = math.cos(turn), math.sin(turn)
    rotation = np.array([[c, -s], [s, c]])
    P = rotation @ np.diag([one**2, other**2]) @ rotation.T
    found = largest_deviation(P[0, 0], P[0, 1], P[1, 1])
    assert found == pytest.approx(max(one, other), rel=1e-9)
    assert found == pytest.approx(math.sqrt(np.linalg.eigvalsh(P)[-1]), rel=1e-12)


def test_largest_deviation_of_a_line_and_of_what_rounding_leaves_of_nothing():
    assert largest_deviation(1.0, -1.0, 1.0) == pytest.approx(math.sqrt(2.0))
    assert largest_deviation(-1e-20, 0.0, -1e-20) == 0.0


def test_uncertainty_of_a_covariance():
    rng = np.random.default_rng(8)
    for _ in range(50):
        root = rng.normal(size=(3, 3)) * 10.0 ** rng.uniform(-3, 1)
        P = root @ root.T
        found = uncertainty_of(P)
        assert found.xy == pytest.approx(math.sqrt(np.linalg.eigvalsh(P[:2, :2])[-1]), rel=1e-9)
        assert found.theta == pytest.approx(math.sqrt(P[2, 2]))
    assert uncertainty_of(np.diag([0.0, 0.0, -1e-20])) == (0.0, 0.0)
