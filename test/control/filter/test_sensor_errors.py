"""Estimated errors of wheels, gyro and landmark sensor: convergence, reset, average over hypotheses, slip."""

import math
from itertools import product

import numpy as np
import pytest
from filter_drives import GYRO_BIAS, Straight
from filter_runs import (
    R_FIX,
    SEPARATION,
    Robot,
    body_twist,
    build_motion,
    covariance,
    fix,
    jacobian,
    midpoint,
    options,
    started,
    winding,
    wrapped,
)
from scipy.stats import chi2, multivariate_normal

from diffbot_control.filter import ekf, models, state
from diffbot_core.geometry import Point
from diffbot_core.kinematics import Twist, TwistCovariance


@pytest.mark.parametrize("variant", ["ekf_calibrating", "ekf_fnn_calibrating"])
def test_the_errors_of_radii_and_wheel_separation_converge(variant):
    # The filter assumes a separation that is 10 % too small.
    robot, true = Robot(np.random.default_rng(4), (-0.03, 0.02)), np.array([-0.03, 0.02, 0.1])
    numbers = options(filter=variant, wheel_radius_sigma=0.1, wheel_separation_sigma=0.1)
    numbers = numbers._replace(separation=SEPARATION / 1.1)
    found = started(numbers)
    for step in range(1500):
        twist, dt, (var_v, cov, var_omega), *_ = robot.move(*winding(step))
        wrong = Twist(twist.v, 1.1 * twist.omega), dt, TwistCovariance(var_v, 1.1 * cov, 1.21 * var_omega)
        ekf.predict(found, numbers, models.Motion(*wrong))
        if step % 2 == 0:
            z = robot.truth + np.sqrt(R_FIX.diagonal()) * robot.rng.normal(size=3)
            ekf.take(found, numbers, fix(z[0], z[1], wrapped(z[2]), time=0.1 * step))
    away = np.abs(found.x[3:6] - true)
    assert away.max() < 0.02
    assert (away < 3.5 * np.sqrt(np.diag(found.P)[3:6])).all()


@pytest.mark.parametrize("index", [0, 1, 2])
@pytest.mark.parametrize(("sigma", "bound"), [(0.1, 0.5), (0.01, 0.1)])
def test_a_wheel_error_beyond_five_deviations_and_a_tenth_resets_all_wheel_errors(index, sigma, bound):
    start = {"left_radius_error": 0.02, "right_radius_error": -0.01, "wheel_separation_error": 0.03}
    numbers = options(wheel_radius_sigma=sigma, wheel_separation_sigma=sigma, **start)
    for size, kept in ((0.99 * bound, True), (-1.01 * bound, False)):
        found, errors = started(numbers), np.array(list(start.values()))
        errors[index] += size
        state.set_errors(found, numbers, models.WHEELS, errors, 1e-8 * np.eye(3))
        ekf.predict(found, numbers, build_motion(1.0, 0.3, 0.1, 1e-4, 0.0, 1e-4))
        ekf.take(found, numbers, fix(0.1, R=np.eye(3)))
        assert found.x[3 + index] == pytest.approx(errors[index] if kept else list(start.values())[index], abs=1e-4)
        assert found.P[3:, :3].any() == kept
    np.testing.assert_allclose(found.x[3:], list(start.values()))
    np.testing.assert_allclose(found.P[3:, 3:], sigma**2 * np.eye(3))


def posterior(mean, P, H, z, R):
    """Return mean and covariance given all measurements ``z``, and the density of ``z``."""
    S = H @ P @ H.T + R
    K = P @ H.T @ np.linalg.inv(S)
    return mean + K @ (z - H @ mean), P - K @ S @ K.T, multivariate_normal.pdf(z, H @ mean, S)


@pytest.mark.parametrize("prior", [0.0, 0.2, 1.0])
@pytest.mark.parametrize("deviation", [0.0, 1.0, 3.0])
@pytest.mark.parametrize("separation_sigma", [0.1, 0.0])
def test_the_estimate_is_the_mixture_of_the_hypotheses_weighted_by_their_evidence(deviation, prior, separation_sigma):
    rng = np.random.default_rng(round(10 * deviation))
    configured = {"left_radius_error": 0.03, "wheel_separation_error": -0.02, "landmark_range_offset": 0.1}
    sigmas = {"wheel_radius_sigma": 0.05, "wheel_separation_sigma": separation_sigma}
    numbers = options((Point(1.0, 2.0),), wheels_as_configured=prior, use_gyro=True, **configured, **sigmas)
    wheels, sensor = np.arange(3, 6), np.arange(7, 10)
    # x and y depend on the wheels, heading and bias on the landmark sensor, so the hypotheses are independent.
    of_wheels, of_sensor = np.array([0, 1, *wheels]), np.array([2, models.BIAS, *sensor])
    mean, P = np.zeros(10), np.zeros((10, 10))
    mean[3:], P[:3, :3], P[models.BIAS, models.BIAS] = numbers.errors, np.diag(covariance(rng, 3).diagonal()), 0.0025
    P[range(3, 10), range(3, 10)] = numbers.variances
    H = np.zeros((10, 10))
    H[np.ix_(range(5), of_wheels)], H[np.ix_(range(5, 10), of_sensor)] = rng.normal(size=(2, 5, 5))
    R, true = 1e-3 * np.eye(10), rng.multivariate_normal(mean, P)
    true[wheels] = mean[wheels] + deviation * np.sqrt(P[wheels, wheels])
    z = rng.multivariate_normal(H @ true, R)
    found = started(numbers, landmarks=1)
    found.x[:], found.P[:, :], _ = posterior(mean, P, H, z, R)
    weights, means, covariances = [], [], []
    for known_wheels, known_sensor in product((False, True), repeat=2):
        known = P.copy()
        for is_known, places in ((known_wheels, wheels), (known_sensor, sensor)):
            if is_known:
                known[places, places] = 0.0
        one, P_one, evidence = posterior(mean, known, H, z, R)
        weights.append(evidence * (prior if known_wheels else 1.0 - prior) * 0.5)
        means.append(one)
        covariances.append(P_one)
    w = np.array(weights) / sum(weights)
    whole = w @ np.array(means)
    spread = sum(a * (C + np.outer(m - whole, m - whole)) for a, m, C in zip(w, means, covariances, strict=True))
    x, P_x = ekf.average(found, numbers)
    whole[2] = wrapped(whole[2])
    np.testing.assert_allclose(x, whole, atol=1e-9)
    np.testing.assert_allclose(P_x, spread, atol=1e-9)


def test_the_reported_heading_is_wrapped():
    numbers = options()
    found = started(numbers, (0.0, 0.0, 3.14), np.eye(3))
    found.x[3], found.P[3, 2], found.P[2, 3] = -0.01, 1e-3, 1e-3
    assert -math.pi < ekf.average(found, numbers)[0][2] < -3.1


@pytest.mark.parametrize("seed", range(3))
def test_the_fusion_of_a_gyro_equals_a_filter_with_the_twist_errors_as_states(seed):
    rng = np.random.default_rng(seed)
    dt, v, omega, variance = 0.1, *rng.uniform(-1.0, 1.0, 2), rng.uniform(1e-5, 1e-2)
    M, numbers = covariance(rng, 2, 0.02, 0.2), options(use_gyro=True)._replace(wheel_walk=0.0, bias_walk=0.0)
    found = started(numbers)
    # The errors are small, so that both filters are linear, and the states are correlated.
    x, P = np.array([*rng.normal(size=3), *rng.normal(0.0, 1e-5, 4)]), 1e-6 * covariance(rng, 7)
    found.x[:], found.P[:, :] = x, P

    def twist(s):
        return body_twist(s, build_motion(v, omega, dt, 0.0, 0.0, 0.0))[0] + s[7:]

    joint, whole = np.array([*x, 0.0, 0.0]), np.zeros((9, 9))
    rate = twist(joint)[1] + x[6] + 1e-4
    motion = build_motion(v, omega, dt, M[0, 0], M[0, 1], M[1, 1], rate=models.TurnRate(rate, variance))
    assert ekf.take_rate(found, numbers, motion) == 0.0
    ekf.predict(found, numbers, motion)
    whole[:7, :7], whole[7:, 7:] = P, M
    H = jacobian(lambda s: np.array([twist(s)[1] + s[6]]), joint)
    S = (H @ whole @ H.T).item() + variance
    K = whole @ H.T / S
    joint, whole = joint + K[:, 0] * 1e-4, whole - K @ K.T * S
    end = lambda s: np.array([*midpoint(s, twist(s), dt), *s[3:7]])  # noqa: E731
    F = jacobian(end, joint)
    np.testing.assert_allclose(found.x, end(joint), atol=1e-8)
    np.testing.assert_allclose(found.P, F @ whole @ F.T, atol=2e-8 * np.abs(P).max() + 1e-10)


def test_a_turn_rate_beyond_the_gate_corrects_with_a_reduced_gain_and_is_returned():
    numbers = options(use_gyro=True, gate_probability=0.99)
    motion = build_motion(0.5, 0.1, 0.1, 1e-4, 0.0, 1e-4, rate=models.TurnRate(1.0, 1e-4))
    found = started(numbers)
    assert ekf.take_rate(found, numbers, motion) == pytest.approx(0.9)
    # Gain var_bias / S, times bound / NIS = bound S / y^2, times y.
    assert found.x[models.BIAS] == pytest.approx(0.05**2 * chi2.ppf(0.99, 1) / 0.9, rel=1e-9)
    S = 2e-4 + 0.05**2 + 1e-4 * ((0.5 - 0.03) ** 2 + (0.5 + 0.03) ** 2) / SEPARATION**2
    on_gate = motion._replace(rate=models.TurnRate(0.1 + 0.97 * math.sqrt(chi2.ppf(0.99, 1) * S), 1e-4))
    assert ekf.take_rate(started(numbers), numbers, on_gate) == 0.0


@pytest.mark.parametrize("seed", range(3))
def test_the_noise_of_the_wheels_does_not_bias_the_radii(seed):
    robot = Straight(seed)
    spread = robot.drive(1500)
    assert np.abs(robot.found.x[3:5]).max() < 0.004  # the prior deviation is 0.01; a bias would reach -0.01
    assert np.diff(spread).max() < 1e-4  # without slip the variances do not increase


@pytest.mark.parametrize("lost", [(0.0, 0.05), (0.05, 0.0), (0.0, 0.12)])
def test_the_radii_follow_the_start_and_the_end_of_slip_within_three_seconds(lost):
    robot = Straight(1)
    robot.drive(500)
    for robot.lost in (np.array(lost), np.zeros(2)):
        robot.drive(150)
        assert robot.found.x[4] - robot.found.x[3] == pytest.approx(robot.lost[0] - robot.lost[1], abs=0.02)
        if robot.lost.any():
            # Either wheel may have slipped, so each radius explains about half of the slip.
            assert abs(robot.found.x[3] + robot.found.x[4]) < 0.5 * max(lost)
        robot.drive(250)
    assert robot.found.x[models.BIAS] == pytest.approx(GYRO_BIAS, abs=0.015)


def test_a_jump_of_the_gyro_bias_at_rest_is_not_explained_by_slip():
    robot = Straight(1)
    robot.drive(200, speed=0.0)
    before = robot.found.P[3:5, 3:5].copy()
    robot.noise = ((rims, rate + 0.01) for rims, rate in robot.noise)
    robot.drive(200, speed=0.0)
    np.testing.assert_allclose(robot.found.P[3:5, 3:5], before, atol=1e-6)
