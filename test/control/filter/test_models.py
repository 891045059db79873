"""The filter's models: motions against fine integrations and sampling, derivatives against finite differences."""

import math

import numpy as np
import pytest
from filter_runs import jacobian, wrapped
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from diffbot_control.filter.landmark_calibration import LandmarkErrors, with_landmark_errors
from diffbot_control.filter.models import (
    RadiusErrors,
    arc_correction,
    expect_landmark,
    heading_innovation,
    lateral_noise,
    linearisation_variance,
    motion_noise,
    move,
    pose_innovation,
    radius_derivatives,
    separation_derivatives,
    with_radius_errors,
    with_separation_error,
)
from diffbot_core.geometry import Point, Pose
from diffbot_core.kinematics import Twist, TwistCovariance

CHECK = settings(max_examples=60)
L = 0.6
POSES = st.builds(Pose, st.floats(-10.0, 10.0), st.floats(-10.0, 10.0), st.floats(-3.0, 3.0))
TWISTS = st.builds(Twist, st.floats(-2.0, 2.0), st.floats(-3.0, 3.0))
TIMES = st.floats(0.01, 0.5)
ERRORS = st.floats(-0.2, 0.2)


def integrated(pose, twist, dt, steps=4000):
    """Follow the unicycle in fine steps of Euler's method about the middle of each."""
    theta = pose.theta + twist.omega * dt * (np.arange(steps) + 0.5) / steps
    way = twist.v * dt / steps
    end = pose.theta + twist.omega * dt
    return np.array([pose.x + way * np.cos(theta).sum(), pose.y + way * np.sin(theta).sum(), end])


def unwrapped(pose, near):
    """The pose as an array, its heading within half a turn of ``near``."""
    return np.array([pose.x, pose.y, near + wrapped(pose.theta - near)])


@CHECK
@given(POSES, TWISTS, TIMES)
def test_a_motion_is_the_arc_to_second_order(pose, twist, dt):
    found = move(pose, twist, dt).end
    assert -math.pi < found.theta <= math.pi
    # The chord is shorter than the way by a factor sin(a) / a, a half of the turn.
    bound = abs(twist.v) * dt * (0.5 * twist.omega * dt) ** 2 / 6.0
    away = unwrapped(found, pose.theta) - integrated(pose, twist, dt)
    assert np.hypot(*away[:2]) <= 1.01 * bound + 1e-7
    assert away[2] == pytest.approx(0.0, abs=1e-12)


@CHECK
@given(POSES, TWISTS, TIMES)
def test_derivatives_of_a_motion_are_its_finite_differences(pose, twist, dt):
    arc = move(pose, twist, dt)

    def end(numbers):
        theta, v = numbers
        return unwrapped(move(Pose(pose.x, pose.y, theta), Twist(v, twist.omega), dt).end, pose.theta)

    found = jacobian(end, [pose.theta, twist.v])
    expected = [[arc.x_theta, arc.x_v], [arc.y_theta, arc.y_v], [1.0, 0.0]]
    np.testing.assert_allclose(found, expected, atol=1e-7)


@CHECK
@given(POSES, TWISTS, TIMES, st.floats(0.0, 1.0), st.floats(0.0, 1.0), st.floats(-0.9, 0.9))
def test_the_noise_of_a_motion_is_that_of_its_twist_through_finite_differences(pose, twist, dt, var_v, var_omega, rho):
    cov = rho * math.sqrt(var_v * var_omega)
    noise = motion_noise(move(pose, twist, dt), twist.v, dt, TwistCovariance(var_v, cov, var_omega))
    G = jacobian(lambda u: unwrapped(move(pose, Twist(*u), dt).end, pose.theta), twist)
    Q = G @ np.array([[var_v, cov], [cov, var_omega]]) @ G.T
    np.testing.assert_allclose(noise, Q[np.triu_indices(3)], atol=1e-7)


def test_a_motion_across_the_robot_adds_its_variance_across():
    arc = move(Pose(1.0, 2.0, 0.5), Twist(0.7, 0.8), 0.1)
    across = np.array([-math.sin(0.54), math.cos(0.54)])
    xx, xy, yy = lateral_noise(arc, 0.1, 0.03)
    np.testing.assert_allclose([[xx, xy], [xy, yy]], 0.03 * np.outer(across, across), atol=1e-15)


@CHECK
@given(TWISTS, ERRORS, ERRORS, ERRORS, st.floats(0.1, 2.0))
def test_the_twist_of_wrong_wheels_is_that_of_their_rims(twist, left, right, error, separation):
    found = with_separation_error(with_radius_errors(twist, RadiusErrors(left, right), separation), error)
    rim_left = (twist.v - 0.5 * twist.omega * separation) * (1.0 + left)
    rim_right = (twist.v + 0.5 * twist.omega * separation) * (1.0 + right)
    expected = 0.5 * (rim_left + rim_right), (rim_right - rim_left) / (separation * (1.0 + error))
    assert found == pytest.approx(expected, abs=1e-12)


@CHECK
@given(POSES, TWISTS, TIMES, ERRORS, ERRORS, ERRORS)
def test_derivatives_by_the_errors_of_the_wheels_are_finite_differences(pose, measured, dt, left, right, error):
    def corrected(left, right, error):
        return with_separation_error(with_radius_errors(measured, RadiusErrors(left, right), L), error)

    def end(errors):
        return unwrapped(move(pose, corrected(*errors), dt).end, pose.theta)

    twist = corrected(left, right, error)
    arc = move(pose, twist, dt)
    radii = np.reshape(radius_derivatives(arc, measured, dt, L, 1.0 + error), (3, 2))
    separation = np.reshape(separation_derivatives(arc, twist, dt, error), (3, 1))
    np.testing.assert_allclose(np.hstack([radii, separation]), jacobian(end, [left, right, error]), atol=1e-7)


def test_innovations_go_the_short_way_round():
    assert heading_innovation(3.1, -3.1) == pytest.approx(6.2 - math.tau)
    assert pose_innovation(Pose(1.0, 2.0, -3.0), Pose(0.5, 3.0, 3.0)) == pytest.approx((0.5, -1.0, math.tau - 6.0))


@CHECK
@given(POSES, st.floats(0.05, 30.0), st.floats(-3.1, 3.1), st.floats(-0.5, 0.5), ERRORS, st.floats(-0.5, 0.5))
def test_a_landmark_is_expected_where_it_is_with_the_errors_of_its_sensor(pose, distance, angle, offset, scale, turn):
    x, y, theta = pose
    landmark = Point(x + distance * math.cos(theta + angle), y + distance * math.sin(theta + angle))

    def measured(numbers):
        x, y, theta, offset, scale = numbers
        seen = complex(landmark.x - x, landmark.y - y) * complex(math.cos(-theta), math.sin(-theta))
        return np.array([(1.0 + scale) * abs(seen) + offset, angle + wrapped(math.atan2(seen.imag, seen.real) - angle)])

    at = [x, y, theta, offset, scale]
    ideal = expect_landmark(pose, landmark, 0.02)
    found = with_landmark_errors(ideal, LandmarkErrors(offset, scale, turn))
    expected = np.add(measured(at), (0.0, turn))
    assert found.range == pytest.approx(expected[0], abs=1e-9)
    assert wrapped(found.bearing - expected[1]) == pytest.approx(0.0, abs=1e-9)
    assert -math.pi < found.bearing <= math.pi
    H = jacobian(measured, at)
    np.testing.assert_allclose([found.range_x, found.range_y, 0.0, 1.0, ideal.range], H[0, :5], atol=1e-6)
    np.testing.assert_allclose([found.bearing_x, found.bearing_y, -1.0], H[1, :3], rtol=1e-4, atol=1e-6)
    by_range, by_bearing = linearisation_variance(distance**2, 0.02)
    # A range in metres of the sensor.
    assert found.added_var_range == pytest.approx((1.0 + scale) ** 2 * by_range)
    assert found.added_var_bearing == pytest.approx(by_bearing)


def test_the_linearisation_error_by_sampling():
    rng, distance, sigma = np.random.default_rng(3), 2.0, 0.1
    along, across = sigma * rng.normal(size=(2, 100_000))
    ranges, bearings = np.hypot(distance - along, across), np.arctan2(-across, distance - along)
    left_out = np.array([np.mean((ranges - distance + along) ** 2), np.mean((bearings + across / distance) ** 2)])
    found = np.array(linearisation_variance(distance**2, 2.0 * sigma**2))
    # A bound, as all of the spread may lie across, and not wasteful.
    assert (left_out <= found).all()
    assert (found <= 5.0 * left_out).all()


@CHECK
@given(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0), st.floats(-3.1, 3.1))
def test_a_correction_along_an_arc_is_the_sum_of_small_turning_steps(dx, dy, turn):
    assume(abs(turn) > 1e-6)
    angles = turn * (np.arange(20_000) + 0.5) / 20_000
    expected = (dx * np.cos(angles) - dy * np.sin(angles)).mean(), (dx * np.sin(angles) + dy * np.cos(angles)).mean()
    assert arc_correction(dx, dy, turn) == pytest.approx(expected, abs=1e-8)
    assert arc_correction(dx, dy, 1e-12) == pytest.approx((dx, dy), abs=1e-11)
