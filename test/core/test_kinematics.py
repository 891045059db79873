"""Kinematics of the differential drive against matrices and the numbers of the paper."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from diffbot_core.data_sheet import DataSheet, rim_speed
from diffbot_core.kinematics import (
    WheelGeometry,
    WheelSpeeds,
    body_twist,
    encoder_covariance,
    twist_covariance,
    wheel_speeds,
)

CHECK = settings(max_examples=100)
GEOMETRIES = st.builds(WheelGeometry, st.floats(0.01, 1.0), st.floats(0.05, 3.0))
SPEEDS = st.floats(-100.0, 100.0)


def to_twist(geometry):
    """Return the matrix that maps the wheel speeds (left, right) to (v, omega)."""
    radius, separation = geometry
    return radius * np.array([[0.5, 0.5], [-1.0 / separation, 1.0 / separation]])


@CHECK
@given(SPEEDS, SPEEDS, GEOMETRIES)
def test_forward_kinematics_are_the_matrix_of_the_paper_and_inverse_kinematics_its_inverse(left, right, geometry):
    twist = body_twist(WheelSpeeds(left, right), geometry)
    np.testing.assert_allclose(twist, to_twist(geometry) @ [left, right], rtol=1e-12, atol=1e-9)
    np.testing.assert_allclose(wheel_speeds(twist, geometry), [left, right], rtol=1e-9, atol=1e-9)


@CHECK
@given(st.floats(0.0, 10.0), st.floats(0.0, 10.0), GEOMETRIES)
def test_the_covariance_of_the_twist_is_that_of_the_wheels_through_the_matrix(sigma_left, sigma_right, geometry):
    G = to_twist(geometry)
    expected = G @ np.diag([sigma_left**2, sigma_right**2]) @ G.T
    var_v, cov, var_omega = twist_covariance(sigma_left, sigma_right, geometry)
    np.testing.assert_allclose([[var_v, cov], [cov, var_omega]], expected, rtol=1e-9, atol=1e-12)


def test_the_wheels_of_the_default_robot_allow_its_largest_speed():
    assert rim_speed(DataSheet()) == pytest.approx(DataSheet().v_max)
    assert rim_speed(DataSheet(wheel_max=10.0, wheels=WheelGeometry(0.1, 0.5))) == 1.0
    assert rim_speed(DataSheet(wheel_max=math.inf)) == math.inf


def test_the_speed_of_a_resting_wheel_has_a_small_covariance():
    var_v, cov, var_omega = encoder_covariance(WheelSpeeds(0.0, 0.0), 0.05, WheelGeometry())
    # sigma = 1e-3 rad/s on each wheel: R^2 sigma^2 / 2 and 2 R^2 sigma^2 / L^2.
    assert var_v == pytest.approx(0.05**2 * 1e-6 / 2.0)
    assert cov == 0.0
    assert var_omega == pytest.approx(2.0 * 0.05**2 * 1e-6 / 0.36)
