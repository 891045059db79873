"""Wheel speeds and twists, against the paper's numbers, matrices and sampling."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from diffbot_core.kinematics import (
    RESTING_SIGMA,
    Twist,
    WheelGeometry,
    WheelSpeeds,
    body_twist,
    encoder_covariance,
    twist_covariance,
    wheel_speeds,
)

CHECK = settings(max_examples=200)
PAPER = WheelGeometry()
GEOMETRIES = st.builds(WheelGeometry, st.floats(0.01, 1.0), st.floats(0.05, 3.0))
SPEEDS = st.floats(-100.0, 100.0)


def to_twist(geometry):
    """Return the matrix from (left, right) wheel speeds to (v, omega)."""
    radius, separation = geometry
    return radius * np.array([[0.5, 0.5], [-1.0 / separation, 1.0 / separation]])


def test_the_papers_robot():
    assert PAPER == (0.05, 0.6)


def test_driving_and_turning_by_hand():
    # 1.3 m/s on wheels of 0.05 m: 26 rad/s each. 1 rad/s on the spot: each wheel goes 0.3 m/s, i.e. 6 rad/s.
    assert wheel_speeds(Twist(1.3, 0.0), PAPER) == pytest.approx((26.0, 26.0))
    assert wheel_speeds(Twist(0.0, 1.0), PAPER) == pytest.approx((-6.0, 6.0))
    # Counter-clockwise about the left wheel: only the right one turns.
    assert wheel_speeds(Twist(0.3, 1.0), PAPER) == pytest.approx((0.0, 12.0))
    assert body_twist(WheelSpeeds(0.0, 12.0), PAPER) == pytest.approx((0.3, 1.0))


def test_the_papers_noise_follows_from_five_percent_per_wheel():
    # Section 4.1: 0.05 * 1.3 = 0.065 m/s and 2 * 0.065 / 0.6 = 0.2167 rad/s, at v_max.
    left, right = wheel_speeds(Twist(1.3, 0.0), PAPER)
    both_fast = body_twist(WheelSpeeds(1.05 * left, 1.05 * right), PAPER)
    assert both_fast == pytest.approx((1.3 + 0.065, 0.0))
    apart = body_twist(WheelSpeeds(0.95 * left, 1.05 * right), PAPER)
    assert apart.v == pytest.approx(1.3)
    assert apart.omega == pytest.approx(0.2167, abs=5e-5)


@CHECK
@given(SPEEDS, SPEEDS, GEOMETRIES)
def test_wheels_to_twist_is_the_printed_matrix_and_back_its_inverse(left, right, geometry):
    twist = body_twist(WheelSpeeds(left, right), geometry)
    np.testing.assert_allclose(twist, to_twist(geometry) @ [left, right], rtol=1e-12, atol=1e-9)
    np.testing.assert_allclose(wheel_speeds(twist, geometry), [left, right], rtol=1e-9, atol=1e-9)


@CHECK
@given(SPEEDS, SPEEDS, GEOMETRIES)
def test_twist_to_wheels_solves_the_printed_equations(v, omega, geometry):
    expected = np.linalg.solve(to_twist(geometry), [v, omega])
    wheels = wheel_speeds(Twist(v, omega), geometry)
    np.testing.assert_allclose(wheels, expected, rtol=1e-9, atol=1e-8)
    np.testing.assert_allclose(body_twist(wheels, geometry), (v, omega), rtol=1e-9, atol=1e-8)


@CHECK
@given(st.floats(0.0, 10.0), st.floats(0.0, 10.0), GEOMETRIES)
def test_twist_covariance_is_g_diag_g(sigma_left, sigma_right, geometry):
    G = to_twist(geometry)
    expected = G @ np.diag([sigma_left**2, sigma_right**2]) @ G.T
    var_v, cov, var_omega = twist_covariance(sigma_left, sigma_right, geometry)
    np.testing.assert_allclose([[var_v, cov], [cov, var_omega]], expected, rtol=1e-9, atol=1e-12)


def test_encoder_covariance_against_sampling():
    rng = np.random.default_rng(3)
    wheels, bound = WheelSpeeds(20.0, -8.0), 0.05
    seen = np.array(wheels) * (1.0 + bound * rng.uniform(-1.0, 1.0, (200_000, 2)))
    sampled = np.cov(to_twist(PAPER) @ seen.T)
    var_v, cov, var_omega = encoder_covariance(wheels, bound, PAPER)
    np.testing.assert_allclose([[var_v, cov], [cov, var_omega]], sampled, rtol=0.02)


def test_a_faster_right_wheel_makes_v_and_omega_err_together():
    assert encoder_covariance(WheelSpeeds(1.0, 20.0), 0.05, PAPER).cov_v_omega > 0.0
    assert encoder_covariance(WheelSpeeds(20.0, 1.0), 0.05, PAPER).cov_v_omega < 0.0


@pytest.mark.parametrize("bound", [0.0, 0.05, 1.0])
def test_a_resting_wheel_still_has_some_noise(bound):
    var_v, cov, var_omega = encoder_covariance(WheelSpeeds(0.0, 0.0), bound, PAPER)
    # sigma = 1e-3 rad/s on each wheel: R^2 sigma^2 / 2 and 2 R^2 sigma^2 / L^2.
    assert RESTING_SIGMA == 1e-3
    assert var_v == pytest.approx(0.05**2 * 1e-6 / 2.0)
    assert cov == 0.0
    assert var_omega == pytest.approx(2.0 * 0.05**2 * 1e-6 / 0.36)


def test_the_variance_does_not_depend_on_the_sign_of_the_speed():
    forward = encoder_covariance(WheelSpeeds(5.0, 7.0), 0.1, PAPER)
    assert encoder_covariance(WheelSpeeds(-5.0, -7.0), 0.1, PAPER) == forward
    # (0.1 / sqrt(3))^2 (25 + 49) = 0.24667, and 2e-6 at rest; times R^2 / 4.
    assert forward.var_v == pytest.approx(0.25 * 0.05**2 * (0.01 / 3.0 * 74.0 + 2e-6))
    assert math.isclose(forward.cov_v_omega, 0.5 * 0.05**2 / 0.6 * 0.01 / 3.0 * 24.0, rel_tol=1e-9)
