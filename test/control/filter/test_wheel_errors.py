"""The errors of the wheels as states: found, forgotten where impossible, and averaged with what is configured."""

import numpy as np
import pytest
from filter_runs import R_FIX, SEPARATION, Robot, build_motion, covariance, fix, gated_filter, winding
from scipy.stats import multivariate_normal

from diffbot_control.filter.averaging import average, average_over
from diffbot_control.filter.belief import ErrorEstimate
from diffbot_control.filter.gated_filter import GatedFilter
from diffbot_control.filter.models import Motion
from diffbot_control.filter.options import FilterConfig, options_of
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist, TwistCovariance


@pytest.mark.parametrize("variant", ["ekf_calibrating", "ekf_fnn_calibrating"])
def test_errors_of_the_radii_and_of_the_wheel_separation_are_found(variant):
    # Wheels 10 % further apart than the filter knows: the robot of the test has the right distance.
    robot, true = Robot(np.random.default_rng(4), (-0.03, 0.02)), np.array([-0.03, 0.02, 0.1])
    options = options_of(FilterConfig(variant, wheel_radius_sigma=0.1, wheel_separation_sigma=0.1))
    found = GatedFilter(options, SEPARATION / 1.1)
    found.reset_to(Pose(0.0, 0.0, 0.0), R_FIX)
    for step in range(1500):
        twist, dt, (var_v, cov, var_omega), _ = robot.move(*winding(step))
        wrong = Twist(twist.v, 1.1 * twist.omega), dt, TwistCovariance(var_v, 1.1 * cov, 1.21 * var_omega)
        found.predict(Motion(*wrong))
        if step % 2 == 0:
            found.take(robot.fix())
    wheels = found.wheels()
    assert np.abs(wheels.errors - true).max() < 0.02
    assert (np.abs(wheels.errors - true) < 3.5 * np.sqrt(wheels.P.diagonal())).all()


@pytest.mark.parametrize("index", [0, 1, 2])
def test_an_error_beyond_five_deviations_resets_all_three(index):
    found = gated_filter("ekf_calibrating", wheel_radius_sigma=0.1, wheel_separation_sigma=0.1)
    for size, kept in ((0.49, True), (0.51, False)):
        errors = np.zeros(3)
        errors[index] = size
        found.set_wheels(ErrorEstimate(errors, 1e-8 * np.eye(3)))
        found.predict(build_motion(1.0, 0.3, 0.1, 1e-4, 0.0, 1e-4))
        found.take(fix(0.0, R=np.eye(3)))
        assert found.wheels().errors.any() == kept
        assert found.memory.belief.P[3:, :3].any() == kept
    np.testing.assert_allclose(found.wheels().P, 0.01 * np.eye(3))


def posterior(prior, P, H, z, R):
    """Return mean, covariance and the density of all measurements ``z`` at once."""
    S = H @ P @ H.T + R
    K = P @ H.T @ np.linalg.inv(S)
    return prior + K @ (z - H @ prior), P - K @ S @ K.T, multivariate_normal.pdf(z, H @ prior, S)


@pytest.mark.parametrize("prior", [0.0, 0.2, 0.5, 1.0])
@pytest.mark.parametrize("first", [3, 4])
@pytest.mark.parametrize("deviation", [0.0, 1.0, 3.0])
def test_it_is_the_mixture_of_both_posteriors_by_their_evidence(first, deviation, prior):
    rng = np.random.default_rng(round(10 * deviation) + first)
    n, errors = first + 3, slice(first, first + 3)
    configured, variances = np.array([0.3, -0.2, 0.1]), np.array([0.04, 0.01, 0.09])
    prior, P = np.zeros(n), covariance(rng, n)
    P[errors, :] = P[:, errors] = 0.0
    prior[errors], P[errors, errors] = configured, np.diag(variances)
    known = P.copy()
    known[errors, errors] = 0.0
    H, R = rng.normal(size=(8, n)), covariance(rng, 8, 0.1, 0.3)
    true = rng.multivariate_normal(prior, known)
    true[errors] += deviation * np.sqrt(variances)
    z = rng.multivariate_normal(H @ true, R)
    x, P_x, evidence = posterior(prior, P, H, z, R)
    other, P_other, other_evidence = posterior(prior, known, H, z, R)
    w = prior * other_evidence / ((1.0 - prior) * evidence + prior * other_evidence)
    mean = w * other + (1.0 - w) * x
    spread = sum(one * np.outer(at - mean, at - mean) for one, at in ((w, other), (1.0 - w, x)))
    found, P_found = average_over(x, P_x, first, tuple(configured), tuple(variances), prior)
    np.testing.assert_allclose(found, mean, atol=1e-9)
    np.testing.assert_allclose(P_found, w * P_other + (1.0 - w) * P_x + spread, atol=1e-9)


def test_wheels_and_landmarks_have_hypotheses_of_their_own():
    rng = np.random.default_rng(0)
    sigmas = {"wheel_radius_sigma": 0.05, "wheel_separation_sigma": 0.1}
    config = FilterConfig(left_radius_error=0.01, wheels_as_configured=0.3, **sigmas)
    options = options_of(config, landmarks=True)
    x, P = rng.normal(0.0, 1e-3, 9), covariance(rng, 9, 1e-3, 1e-2)
    wheels = average_over(x, P, 3, (0.01, 0.0, 0.0), (0.05**2, 0.05**2, 0.1**2), 0.3)
    both = average_over(*wheels, 6, (0.0, 0.0, 0.0), (0.05**2, 0.01**2, 0.01**2), 0.5)
    for found, expected in zip(average(x, P, 3, 6, options), both, strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-12)
    without = average(x[:6], P[:6, :6], 3, 6, options_of(config))
    np.testing.assert_allclose(without[0], wheels[0][:6], rtol=1e-12)


def test_the_heading_stays_within_half_a_turn():
    P = np.diag([1.0, 1.0, 1.0, 0.01])
    P[2, 3] = P[3, 2] = 0.05
    found, _ = average_over(np.array([0.0, 0.0, 3.14, -0.1]), P, 3, (0.0, 0.0, 0.0), (0.01, 0.0, 0.0), 0.5)
    assert -np.pi < found[2] < -2.9
