"""The filter, against finite differences, a textbook update and its own claims about its errors."""

import math

import numpy as np
import pytest
from filter_runs import build_motion, wrapped
from filterpy.kalman import ExtendedKalmanFilter
from scipy.stats import chi2

from diffbot_control.filter.ekf import PoseEkf
from diffbot_core.geometry import Pose


@pytest.fixture(scope="module", autouse=True)
def straight_corrections():
    """The textbook's corrections are straight; those along an arc, of a lost heading, have tests of their own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("diffbot_control.filter.ekf.TURNED_VARIANCE", math.inf)
        yield


def started(state, P):
    ekf = PoseEkf()
    ekf.set_state(np.array(state), P)
    return ekf


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


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_updates_go_the_short_way_across_pi(side):
    # Estimate and fix lie 0.1 rad to either side of pi with equal weights: the answer lies on pi, not on 0.
    start = (0.0, 0.0, side * (math.pi - 0.1))
    measured = -side * (math.pi - 0.1)
    for update, z, numbers in (("update_pose", Pose(0.0, 0.0, measured), 3), ("update_heading", measured, 1)):
        ekf = started(start, np.eye(3))
        getattr(ekf, update)(z, np.eye(numbers))
        assert abs(ekf.x[2]) == pytest.approx(math.pi, abs=1e-12)


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


@pytest.mark.parametrize(("q_factor", "r_factor"), [(0.1, 1.0), (1.0, 4.0)])
def test_wrong_noise_would_show(q_factor, r_factor):
    total = normalised_errors(q_factor, r_factor, runs=60).sum()
    low, high = chi2.ppf([0.005, 0.995], 180)
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
