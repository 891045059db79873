"""The filter, against finite differences, a textbook update and its own claims about its errors."""

import math

import numpy as np
import pytest
from filter_runs import (
    build_motion,
)
from filterpy.kalman import ExtendedKalmanFilter
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from diffbot_control.filter.ekf import PoseEkf
from diffbot_core.geometry import Pose

CHECK = settings(max_examples=150)
STATES = st.tuples(st.floats(-10.0, 10.0), st.floats(-10.0, 10.0), st.floats(-3.1, 3.1))
TWISTS = st.tuples(st.floats(-2.0, 2.0), st.floats(-3.0, 3.0), st.floats(0.01, 0.5))


@pytest.fixture(scope="module", autouse=True)
def straight_corrections():
    """The textbook's corrections are straight; those along an arc, of a lost heading, have tests of their own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("diffbot_control.filter.ekf.TURNED_VARIANCE", math.inf)
        yield


def wrapped(angle):
    return math.remainder(angle, 2.0 * math.pi)


def model(state, v, omega, dt):
    """The motion model of the class's docstring, written anew."""
    x, y, theta = state
    middle = theta + 0.5 * omega * dt
    return np.array([x + v * dt * math.cos(middle), y + v * dt * math.sin(middle), theta + omega * dt])


def jacobian(function, at, step=1e-6):
    """Central differences, one column per argument."""
    columns = []
    for index in range(len(at)):
        plus, minus = np.array(at, float), np.array(at, float)
        plus[index] += step
        minus[index] -= step
        columns.append((function(plus) - function(minus)) / (2.0 * step))
    return np.column_stack(columns)


def covariance(seed, size=3):
    root = np.random.default_rng(seed).normal(size=(size, size))
    return root @ root.T + 0.1 * np.eye(size)


def started(state, P):
    ekf = PoseEkf()
    ekf.set_state(np.array(state), P)
    return ekf


def textbook_update(x, P, innovation, H, R):
    """Kalman's update in its short form, with a solver instead of an inverse."""
    S = H @ P @ H.T + R
    K = np.linalg.solve(S, H @ P).T
    return x + K @ innovation, (np.eye(3) - K @ H) @ P


@CHECK
@given(STATES, TWISTS, st.integers(0, 1000))
def test_predict_is_the_textbook_step_of_the_documented_model(state, twist, seed):
    v, omega, dt = twist
    P, M = covariance(seed), 0.01 * covariance(seed + 1, 2)
    ekf = started(state, P)
    ekf.predict(build_motion(v, omega, dt, M[0, 0], M[0, 1], M[1, 1]))
    F = jacobian(lambda s: model(s, v, omega, dt), state)
    G = jacobian(lambda u: model(state, u[0], u[1], dt), [v, omega])
    expected = model(state, v, omega, dt)
    np.testing.assert_allclose(ekf.x[:2], expected[:2], atol=1e-12)
    assert wrapped(ekf.x[2] - expected[2]) == pytest.approx(0.0, abs=1e-12)
    assert -math.pi < ekf.x[2] <= math.pi
    np.testing.assert_allclose(ekf.F, F, atol=1e-8)
    np.testing.assert_allclose(ekf.Q, G @ M @ G.T, atol=1e-9)
    np.testing.assert_allclose(ekf.P, F @ P @ F.T + G @ M @ G.T, rtol=1e-6, atol=1e-7)


def test_q_by_hand():
    # Straight along +y for 0.5 s at 2 m/s: 1 m; M = [[0.04, 0.01], [0.01, 0.09]].
    # G = [[0, -0.5], [0.5, 0], [0, 0.5]]: an error of omega moves the end to the side by v dt^2 / 2 = 0.25 m s.
    ekf = started((0.0, 0.0, 0.5 * math.pi), np.zeros((3, 3)))
    ekf.predict(build_motion(2.0, 0.0, 0.5, 0.04, 0.01, 0.09))
    G = np.array([[0.0, -0.25], [0.5, 0.0], [0.0, 0.5]])
    expected = G @ np.array([[0.04, 0.01], [0.01, 0.09]]) @ G.T
    np.testing.assert_allclose(ekf.P, expected, atol=1e-15)


def arc(state, v, omega, dt):
    x, y, theta = state
    end = theta + omega * dt
    radius = v / omega
    return np.array(
        [
            x + radius * (math.sin(end) - math.sin(theta)),
            y - radius * (math.cos(end) - math.cos(theta)),
            end,
        ]
    )


def test_the_model_follows_the_arc_to_second_order():
    # Halving the time of a step has to divide its error by eight.
    errors = []
    for dt in (0.2, 0.1):
        ekf = started((1.0, -2.0, 0.4), np.eye(3))
        ekf.predict(build_motion(1.2, 0.9, dt, 0.0, 0.0, 0.0))
        errors.append(np.linalg.norm(ekf.x - arc((1.0, -2.0, 0.4), 1.2, 0.9, dt)))
    assert 7.8 < errors[0] / errors[1] < 8.2


@CHECK
@given(STATES, st.tuples(*[st.floats(-1.0, 1.0)] * 3), st.integers(0, 1000))
def test_pose_update_is_the_textbooks(state, offset, seed):
    P, R = covariance(seed), covariance(seed + 1)
    z = np.array(state) + offset
    z[2] = wrapped(z[2])
    ekf = started(state, P)
    ekf.update_pose(Pose(*z), R)
    x, P_after = textbook_update(np.array(state), P, np.array(offset), np.eye(3), R)
    np.testing.assert_allclose(ekf.x[:2], x[:2], rtol=1e-9, atol=1e-9)
    assert wrapped(ekf.x[2] - x[2]) == pytest.approx(0.0, abs=1e-9)
    assert -math.pi < ekf.x[2] <= math.pi
    np.testing.assert_allclose(ekf.P, P_after, rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(ekf.P, ekf.P.T, atol=1e-12)


@CHECK
@given(STATES, st.floats(-1.5, 1.5), st.integers(0, 1000), st.floats(1e-4, 1.0))
def test_heading_update_is_the_textbooks(state, offset, seed, variance):
    P = covariance(seed)
    H, R = np.array([[0.0, 0.0, 1.0]]), np.array([[variance]])
    ekf = started(state, P)
    ekf.update_heading(wrapped(state[2] + offset), R)
    x, P_after = textbook_update(np.array(state), P, np.array([offset]), H, R)
    np.testing.assert_allclose(ekf.x[:2], x[:2], rtol=1e-9, atol=1e-9)
    assert wrapped(ekf.x[2] - x[2]) == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_allclose(ekf.P, P_after, rtol=1e-8, atol=1e-10)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_updates_go_the_short_way_across_pi(side):
    # Estimate and fix lie 0.1 rad to either side of pi with equal weights: the answer lies on pi, not on 0.
    start = (0.0, 0.0, side * (math.pi - 0.1))
    measured = -side * (math.pi - 0.1)
    for update, z, numbers in (("update_pose", Pose(0.0, 0.0, measured), 3), ("update_heading", measured, 1)):
        ekf = started(start, np.eye(3))
        getattr(ekf, update)(z, np.eye(numbers))
        assert abs(ekf.x[2]) == pytest.approx(math.pi, abs=1e-12)


def test_predicting_across_pi_wraps():
    ekf = started((0.0, 0.0, 3.1), np.eye(3))
    ekf.predict(build_motion(0.0, 1.0, 0.1, 0.0, 0.0, 0.0))
    assert ekf.x[2] == pytest.approx(3.2 - 2.0 * math.pi)


def test_it_starts_knowing_nothing():
    ekf = PoseEkf()
    ekf.update_pose(Pose(5.0, -7.0, 2.0), np.diag([0.03, 0.03, 0.01]))
    np.testing.assert_allclose(ekf.x, [5.0, -7.0, 2.0], rtol=2e-3)
    np.testing.assert_allclose(ekf.P, np.diag([0.03, 0.03, 0.01]), rtol=2e-3, atol=1e-9)


def test_neither_inputs_nor_old_results_are_changed():
    x, P = np.array([1.0, 2.0, 3.0]), np.eye(3)
    z, R = np.array([1.5, 2.5, -3.0]), 0.5 * np.eye(3)
    ekf = PoseEkf()
    ekf.set_state(x, P)
    old_x, old_P = ekf.x, ekf.P
    ekf.predict(build_motion(1.0, 1.0, 0.1, 0.1, 0.0, 0.1))
    ekf.update_pose(Pose(*z), R)
    ekf.update_heading(3.0, np.array([[0.1]]))
    np.testing.assert_array_equal(x, [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(P, np.eye(3))
    np.testing.assert_array_equal(z, [1.5, 2.5, -3.0])
    np.testing.assert_array_equal(R, 0.5 * np.eye(3))
    np.testing.assert_array_equal(old_x, [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(old_P, np.eye(3))


def normalised_errors(q_factor=1.0, r_factor=1.0, runs=200, steps=30):
    """Return e' P^-1 e at the end of each run; the trial's number is its seed."""
    M = np.array([[4e-3, 3e-3], [3e-3, 0.02]])
    R = np.diag([0.03, 0.02, 0.01])
    found = []
    for run in range(runs):
        rng = np.random.default_rng(run)
        P = np.diag([0.2, 0.2, 0.05])
        truth = np.array([1.0, 2.0, 3.0])
        ekf = started(truth + rng.multivariate_normal(np.zeros(3), P), P)
        for step in range(steps):
            v, omega = 1.0, 0.8 * math.sin(0.2 * step)
            real_v, real_omega = rng.multivariate_normal([v, omega], M)
            truth = arc(truth, real_v, real_omega, 0.1)
            Q = q_factor * M
            ekf.predict(build_motion(v, omega, 0.1, Q[0, 0], Q[0, 1], Q[1, 1]))
            if step % 3 == 0:
                z = truth + rng.multivariate_normal(np.zeros(3), R)
                ekf.update_pose(Pose(*z), r_factor * R)
            if step % 5 == 0:
                z = np.array([truth[2] + rng.normal(0.0, 0.1)])
                ekf.update_heading(float(z[0]), np.array([[r_factor * 0.01]]))
        error = ekf.x - truth
        error[2] = wrapped(error[2])
        found.append(error @ np.linalg.solve(ekf.P, error))
    return np.array(found)


def test_the_errors_are_as_large_as_p_says():
    # The sum over 200 independent runs is chi-square with 600 degrees of freedom if P tells the truth.
    total = normalised_errors().sum()
    low, high = chi2.ppf([0.005, 0.995], 600)
    assert low < total < high


@pytest.mark.parametrize(("q_factor", "r_factor"), [(0.1, 1.0), (1.0, 0.25), (1.0, 4.0), (10.0, 1.0)])
def test_wrong_noise_would_show(q_factor, r_factor):
    total = normalised_errors(q_factor, r_factor, runs=100).sum()
    low, high = chi2.ppf([0.005, 0.995], 300)
    assert not low < total < high


@pytest.mark.parametrize("states", [3, 5])
def test_a_correction_is_that_of_filterpys_own_update(states):
    rng = np.random.default_rng(states)
    for _ in range(50):
        root, noise = rng.normal(size=(states, states)), rng.normal(size=(3, 3))
        x, P, R = rng.normal(size=states), root @ root.T, noise @ noise.T + 0.1 * np.eye(3)
        measured = Pose(*(x[:3] + rng.normal(scale=0.3, size=3)))
        ours = PoseEkf(states - 3)
        ours.set_state(x, P)
        nis = ours.update_pose(measured, R)
        theirs = ExtendedKalmanFilter(dim_x=states, dim_z=3)
        theirs.x, theirs.P = x.copy(), P.copy()
        H = np.eye(3, states)

        def residual(z, expected):
            y = z - expected
            y[2] = math.remainder(y[2], 2.0 * math.pi)
            return y

        theirs.update(np.array(measured), lambda _, H=H: H, lambda x, H=H: H @ x, R=R, residual=residual)
        theirs.x[2] = math.remainder(theirs.x[2], 2.0 * math.pi)
        np.testing.assert_allclose(ours.x, theirs.x, rtol=1e-10, atol=1e-10)
        np.testing.assert_allclose(ours.P, theirs.P, rtol=1e-10, atol=1e-10)
        assert nis == pytest.approx(float(theirs.y @ theirs.SI @ theirs.y), rel=1e-9)
