"""The filter with any of its states, against a textbook's steps with finite differences, and its own claims."""

import math

import numpy as np
import pytest
from filter_runs import SEPARATION, build_motion, covariance, gated_filter, jacobian, wrapped
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import multivariate_normal

from diffbot_control.filter.ekf import PoseEkf
from diffbot_control.filter.gate import ACCEPTED, IGNORED
from diffbot_control.filter.measurements import Heading, LandmarkMeasurement, PoseFix, PositionFix
from diffbot_control.filter.models import MIN_LANDMARK_DISTANCE, TURNED_VARIANCE, linearisation_variance
from diffbot_core.geometry import Point, Pose

CHECK = settings(max_examples=100)
LAYOUTS = st.tuples(st.sampled_from((0, 2, 3)), st.booleans())
"""Number of errors of the wheels, and whether the three errors of landmarks are states."""
SEEDS = st.integers(0, 10_000)
STATES = st.tuples(st.floats(-10.0, 10.0), st.floats(-10.0, 10.0), st.floats(-3.1, 3.1))
TWISTS = st.tuples(st.floats(-2.0, 2.0), st.floats(-3.0, 3.0), st.floats(0.01, 0.5))


def started(layout, pose, seed):
    """A filter at a pose, with small errors and a covariance that keeps its corrections straight."""
    wheels, landmark_states = layout
    rng, ekf = np.random.default_rng(seed), PoseEkf(wheels, landmark_states=landmark_states)
    x = np.array([*pose, *rng.uniform(-0.1, 0.1, ekf.x.size - 3)])
    P = covariance(rng, x.size, 0.02, 0.9 * math.sqrt(TURNED_VARIANCE))
    ekf.set_state(x, P)
    ekf.wheel_separation, ekf.random_walk = SEPARATION, 1e-3
    return ekf, x, P, rng


def moved(x, wheels, twist, dt):
    """The documented motion: rims of wheels of wrong size and distance, along the heading halfway."""
    v, omega = twist
    left, right = (x[3], x[4]) if wheels else (0.0, 0.0)
    rim_left, rim_right = (v - 0.5 * omega * SEPARATION) * (1.0 + left), (v + 0.5 * omega * SEPARATION) * (1.0 + right)
    v, omega = 0.5 * (rim_left + rim_right), (rim_right - rim_left) / SEPARATION
    if wheels == 3:
        omega /= 1.0 + x[5]
    middle = x[2] + 0.5 * omega * dt
    return np.array([x[0] + v * dt * math.cos(middle), x[1] + v * dt * math.sin(middle), x[2] + omega * dt, *x[3:]])


def assert_state(ekf, x, P, tolerance=1e-7):
    away = ekf.x - x
    away[2] = wrapped(away[2])
    np.testing.assert_allclose(away, 0.0, atol=tolerance)
    assert -math.pi < ekf.x[2] <= math.pi
    np.testing.assert_allclose(ekf.P, P, rtol=1e-6, atol=tolerance)


@CHECK
@given(LAYOUTS, STATES, TWISTS, SEEDS)
def test_predict_is_the_textbooks_step_of_the_documented_model(layout, pose, motion, seed):
    ekf, x, P, rng = started(layout, pose, seed)
    wheels, (v, omega, dt), M = layout[0], motion, covariance(rng, 2, 0.05, 0.3)
    ekf.predict(build_motion(v, omega, dt, M[0, 0], M[0, 1], M[1, 1]))
    F = jacobian(lambda one: moved(one, wheels, (v, omega), dt), x)
    # The noise acts on the twist of the body: as on wheels without errors, at the corrected twist.
    zeros = np.zeros_like(x)
    v_body, omega_body = moved(np.array([0.0, 0.0, 0.0, *x[3:]]), wheels, (v, omega), 1e-9)[[0, 2]] / 1e-9
    G = jacobian(lambda u: moved([*x[:3], *zeros[3:]], 0, u, dt)[:3], (v_body, omega_body))
    Q = np.zeros_like(P)
    Q[:3, :3] = G @ M @ G.T
    Q[range(3, 3 + wheels), range(3, 3 + wheels)] = 1e-3 * dt
    assert_state(ekf, moved(x, wheels, (v, omega), dt), F @ P @ F.T + Q)


def textbook(x, P, y, H, R):
    """Kalman's update in its short form, and the NIS by the logarithm of scipy's density."""
    S = H @ P @ H.T + R
    K = np.linalg.solve(S, H @ P).T
    nis = -2.0 * multivariate_normal(cov=S).logpdf(y) - np.linalg.slogdet(2.0 * math.pi * S)[1]
    return x + K @ y, P - K @ S @ K.T, nis


@CHECK
@given(LAYOUTS, STATES, SEEDS)
def test_fixes_and_headings_correct_as_the_textbook_says(layout, pose, seed):
    for rows in ([0, 1, 2], [0, 1], [2]):
        ekf, x, P, rng = started(layout, pose, seed)
        H, R, y = np.eye(x.size)[rows], covariance(rng, len(rows)), rng.normal(0.0, 0.5, len(rows))
        z = x[rows] + y
        if 2 in rows:
            z[-1] = wrapped(z[-1])
        if len(rows) == 3:
            found = ekf.correct(PoseFix(0, Pose(*z), R))
        else:
            found = ekf.correct(PositionFix(0, *z, R) if len(rows) == 2 else Heading(0, *z, R))
        x, P, nis = textbook(x, P, y, H, R)
        assert found == pytest.approx(nis, rel=1e-8, abs=1e-9)
        assert_state(ekf, x, P)


def sight(x, landmark, errors):
    """Range and bearing by a sensor with these errors: offset and scale of ranges, offset of bearings."""
    seen = complex(landmark.x - x[0], landmark.y - x[1]) * complex(math.cos(x[2]), -math.sin(x[2]))
    return np.array([(1.0 + errors[1]) * abs(seen) + errors[0], math.atan2(seen.imag, seen.real) + errors[2]])


@CHECK
@given(LAYOUTS, STATES, st.floats(0.5, 30.0), st.floats(-2.9, 2.9), st.sampled_from((None, 0, 1)), SEEDS)
def test_landmarks_correct_as_the_textbook_says_with_finite_differences(layout, pose, away, angle, missing, seed):
    ekf, x, P, rng = started(layout, pose, seed)
    direction = pose[2] + angle
    landmark = Point(pose[0] + away * math.cos(direction), pose[1] + away * math.sin(direction))
    states = layout[1]
    measured = lambda one: sight(one, landmark, one[-3:] if states else (0.0, 0.0, 0.0))  # noqa: E731
    R, y, H = covariance(rng, 2), rng.normal(0.0, 0.2, 2), jacobian(measured, x)
    z = measured(x) + y
    # What the derivatives leave out counts as noise, in metres of the sensor.
    by_range, by_bearing = linearisation_variance(away**2, P[0, 0] + P[1, 1])
    stretch = 1.0 + (x[-2] if states else 0.0)
    noise = R + np.diag([stretch**2 * by_range, by_bearing])
    rows = [row for row in (0, 1) if row != missing]
    if missing is not None:
        R[missing, missing] = (math.inf, math.nan)[missing]
    found = ekf.correct(LandmarkMeasurement(0, z[0], wrapped(z[1]), R, landmark))
    x, P, nis = textbook(x, P, y[rows], H[rows], noise[np.ix_(rows, rows)])
    assert found == pytest.approx(nis, rel=1e-5, abs=1e-7)
    assert_state(ekf, x, P, 1e-6)


def test_the_linearisation_error_is_bounded_by_sampling():
    rng, distance, sigma = np.random.default_rng(3), 2.0, 0.1
    along, across = sigma * rng.normal(size=(2, 100_000))
    ranges, bearings = np.hypot(distance - along, across), np.arctan2(-across, distance - along)
    left_out = np.array([np.mean((ranges - distance + along) ** 2), np.mean((bearings + across / distance) ** 2)])
    found = np.array(linearisation_variance(distance**2, 2.0 * sigma**2))
    # A bound, as all of the spread may lie across, and not wasteful.
    assert (left_out <= found).all()
    assert (found <= 5.0 * left_out).all()


@pytest.mark.parametrize(("away", "corrected"), [(0.0, False), (0.999, False), (1.01, True)])
def test_a_landmark_under_the_robot_corrects_nothing(away, corrected):
    found = gated_filter("ekf", (1.0, 2.0, 3.0), 0.1 * np.eye(3), gate_probability=1.0)
    (x, P), point = found.memory.belief, Point(1.0 + away * MIN_LANDMARK_DISTANCE, 2.0)
    outcome = found.take(LandmarkMeasurement(0, 0.5, 0.1, 0.1 * np.eye(2), point))
    assert outcome == (ACCEPTED if corrected else IGNORED)
    assert math.isfinite(found.nis) == corrected
    assert np.array_equal(found.memory.belief.x, x) != corrected
    assert (found.memory.belief.P[0, 0] < P[0, 0]) == corrected
    assert np.isfinite(found.memory.belief.x).all()


def test_with_an_uncertain_heading_a_correction_follows_an_arc():
    ekf, P = PoseEkf(), np.diag([0.5, 0.4, 0.9])
    P[0, 2] = P[2, 0] = 0.3
    x, y, R = np.array([1.0, 2.0, 0.5]), np.array([0.5, -0.4, 1.2]), np.diag([0.1, 0.2, 0.3])
    ekf.set_state(x, P)
    ekf.correct(PoseFix(0, Pose(*(x + y)), R))
    straight, P_after, _ = textbook(x, P, y, np.eye(3), R)
    dx, dy, turn = straight - x
    # The exponential map of SE(2): the sum of many small steps while turning.
    angles = turn * (np.arange(20_000) + 0.5) / 20_000
    along = (dx + 1j * dy) * np.exp(1j * angles).mean()
    np.testing.assert_allclose(ekf.x, [1.0 + along.real, 2.0 + along.imag, 0.5 + turn], atol=1e-8)
    T = np.array([[math.cos(turn), -math.sin(turn), 0.0], [math.sin(turn), math.cos(turn), 0.0], [0.0, 0.0, 1.0]])
    np.testing.assert_allclose(ekf.P, T @ P_after @ T.T, atol=1e-12)
