"""Noise statistic of a source: scale and correlation of simulated errors, and the mean NIS and autocorrelation."""

import math

import numpy as np
import pytest
from filter_drives import DT, Run
from filter_runs import R_FIX, build_motion, fix, options, reading, started
from scipy.linalg import solve_toeplitz
from scipy.stats import binom, chi2, norm

from diffbot_control.filter import ekf, noise, state
from diffbot_control.filter.consistency import consistency_of
from diffbot_control.filter.ekf import ACCEPTED
from diffbot_control.filter.models import BEARING, HEADING, POSITION_FIX, RANGE, WHEELS, size_of
from diffbot_core.geometry import Point, Pose


@pytest.mark.parametrize("c", [0.3, 0.6, 0.9])
def test_the_correlation_follows_from_the_means_of_differences_and_products(c):
    def estimated(difference, motion, product, pairs=200.0):
        row, means = np.zeros(noise.COLUMNS), (difference, motion, product, 1.0, pairs, pairs, 1.0)
        row[: noise.CHANNEL] = row[noise.CHANNEL : 2 * noise.CHANNEL] = means
        row[noise.PERIOD] = DT
        noise.update_scale_and_time(row)
        return noise.assumed_correlation(row, 0.0)

    # For errors of variance R, half the squared difference has the mean 1 - c and the product the mean c.
    assert estimated(1.0 - c, 0.0, c) == pytest.approx(c)
    assert estimated(1.0 - c + 0.1, 0.1, c) == pytest.approx(c)
    assert estimated(0.1 * (1.0 - c), 0.0, 0.1 * c) == pytest.approx(c), "the claimed R is ten times too large"
    assert estimated(1.0 - c, 0.0, 0.0) == 0.0, "the errors are white, and the claimed R is too large"
    assert estimated(1.0, 0.0, c) == 0.0, "the estimate drifts"
    assert estimated(1.0 - c, 0.0, c, 1.0) == 0.0, "there is one pair only"


@pytest.mark.parametrize(("position", "angle"), [(10.0, 1.0), (1.0, 10.0), (0.1, 10.0)])
def test_a_scale_above_1_is_estimated_for_position_and_heading_separately(position, angle):
    runs = [Run("fixes", 0.0, seed, (position, angle), 0.01, gate_probability=1.0) for seed in range(8)]
    estimated = np.exp(np.mean([np.log(run.scales()) for run in runs], axis=0))
    # Neighbouring pairs share a measurement: the mean of 200 has a deviation of 12 %, the mean of eight runs 4 %.
    np.testing.assert_allclose(estimated, (max(position, 1.0), max(angle, 1.0)), rtol=0.15)
    assert sum(run.correlation() > 0.0 for run in runs) <= binom.ppf(0.999, 8, norm.sf(2.0))


def test_white_fixes_with_the_right_covariance_change_the_noise_only_by_chance():
    runs = [Run("fixes", 0.0, seed) for seed in range(20)]
    assert sum(run.correlation() > 0.0 for run in runs) <= binom.ppf(0.999, 20, norm.sf(2.0))
    assert sum((run.scales() != 1.0).any() for run in runs) <= binom.ppf(0.999, 20, 4.0 * norm.sf(3.0))
    assert np.mean([run.nees for run in runs]) == pytest.approx(3.0, abs=0.6)


@pytest.mark.parametrize("kind", [POSITION_FIX, HEADING, BEARING])
def test_past_corrections_with_too_small_a_covariance_are_compensated_when_the_scale_increases(kind):
    # The position is known for an angle, and the landmark far away, so that a bearing measures the heading.
    at, prior = (0, (1.0, 1.0, 1e-12)) if kind == POSITION_FIX else (2, (1e-12, 1e-12, 1.0))
    landmarks, variance, rng = [Point(1000.0, 0.0)] if kind == BEARING else (), 1e-4, np.random.default_rng(4)
    numbers = options(landmarks, filter="ekf", gate_probability=1.0)
    found, m = started(numbers, P=np.diag(prior), landmarks=len(landmarks)), size_of(kind)
    found.P[WHEELS:, WHEELS:] = 0.0  # the landmark sensor has no errors
    for step in range(100):
        z = math.sqrt(10.0 * variance) * rng.normal(size=m)
        ekf.take(found, numbers, reading(kind, z, variance * np.eye(m), 0.2 * step, (1000.0, 0.0)))
    # Expected: the variance of the mean of 100 measurements of ten times the variance.
    assert 0.9 < found.P[at, at] / (10.0 * variance / 100.0) < 1.7


def test_the_scale_of_landmarks_is_never_below_1():
    assert (Run("landmarks", 0.0, 0, (0.1, 0.1)).scales() == 1.0).all()
    scales = Run("landmarks", 0.0, 0, (10.0, 4.0), gate_probability=1.0).scales()
    np.testing.assert_allclose(scales, (10.0, 4.0), rtol=0.3)


def test_a_range_and_a_bearing_of_one_landmark_do_not_form_a_pair():
    numbers, rng = options([Point(5.0, 0.0)], filter="ekf"), np.random.default_rng(4)
    found = started(numbers, P=1e-6 * np.eye(3), landmarks=1)
    for step in range(200):
        kind, exact, sigma = ((RANGE, 5.0, 0.3), (BEARING, 0.0, 0.1))[step % 2]
        z = [rng.normal(exact, sigma)]
        ekf.take(found, numbers, reading(kind, z, sigma**2 * np.eye(1), 0.1 * step, (5.0, 0.0), place=3))
    assert noise.scale_of(found.noise[2], False) == noise.scale_of(found.noise[2], True) == 1.0


@pytest.mark.study
@pytest.mark.parametrize(
    ("kind", "c", "seeds", "within"),
    [("fixes", 0.5, 8, 0.05), ("fixes", 0.9, 8, 0.05), ("fixes", 0.98, 8, 0.05), ("landmarks", 0.93, 2, 0.03)],
)
def test_the_covariance_is_consistent_for_time_correlated_errors(kind, c, seeds, within):
    runs, without = ([Run(kind, c, seed, detect_correlation=on) for seed in range(seeds)] for on in (True, False))
    nees, nees_without = (np.mean([run.nees for run in some]) for some in (runs, without))
    assert 1.0 < nees < 5.0
    assert nees_without > 2.0 * nees
    rmse, rmse_without = (math.sqrt(np.mean([run.squares for run in some])) for some in (runs, without))
    assert rmse < 1.05 * rmse_without
    assert np.mean([run.correlation() for run in runs]) == pytest.approx(c, abs=within)


def test_repeated_values_do_not_make_a_source_precise():
    numbers = options(filter="ekf")
    found = started(numbers)
    for step in range(100):
        ekf.predict(found, numbers, build_motion(0.0, 0.0, 0.1, 1e-6, 0.0, 1e-6))
        ekf.take(found, numbers, fix(0.0, time=0.1 * step))
    assert noise.scale_of(found.noise[0], False) == noise.scale_of(found.noise[0], True) == 1.0
    assert np.linalg.inv(found.P)[0, 0] <= 101.0 / R_FIX[0, 0]


def test_the_noise_statistic_survives_a_new_pose_but_not_a_reset():
    run = Run("fixes", 0.9, 0)
    before = run.row[: noise.NIS].copy()
    state.start(run.found, Pose(9.0, 9.0, 0.0), R_FIX)
    np.testing.assert_array_equal(run.row[: noise.NIS], before)
    assert not run.row[noise.NIS :].any()
    # The first fix after the new pose does not form a pair with the fix before.
    ekf.take(run.found, run.options, fix(9.0, 9.0, time=99.0))
    assert run.row[noise.WHITENESS_NUMBERS] == 0.0
    state.reset(run.found, run.options)
    assert (run.correlation(), run.scales().tolist()) == (0.0, [1.0, 1.0])


def test_with_a_known_correlation_time_r_is_inflated_by_it_and_nothing_is_estimated():
    run, c = Run("fixes", 0.9, 0, correlation_times=(2.0,)), math.exp(-0.7 / 2.0)
    assert (run.scales().tolist(), run.row[noise.TIME]) == ([1.0, 1.0], 0.0)
    found = started(run.options)
    ekf.take(found, run.options, fix(0.0, time=1.0))
    P = found.P.copy()
    ekf.take(found, run.options, fix(0.0, time=1.7))
    np.testing.assert_allclose(found.P, P - P @ np.linalg.inv(P + R_FIX * (1.0 + c) / (1.0 - c)) @ P, atol=1e-12)
    assert consistency_of(run.row, 2.0).assumed == pytest.approx(math.exp(-DT / 2.0), abs=0.01)


@pytest.mark.parametrize(("dt", "time"), [(0.2, 0.3), (0.5, 2.0), (1.0, 0.1)])
def test_the_inflation_gives_the_variance_of_the_best_estimate_of_a_constant(dt, time):
    # The information of n measurements with covariance V is 1' V^-1 1.
    n = 2000
    information = solve_toeplitz(np.exp(-dt / time) ** np.arange(n), np.ones(n)).sum() / n
    assert noise.inflation_after(dt, time) == pytest.approx(1.0 / information, rel=0.02)
    assert noise.inflation_after(dt, 0.0) == 1.0


@pytest.mark.parametrize("bad", [(61.0, 0.0, 0.4), (0.2, 2.5, 0.4), (0.2, 0.0, 0.0), (0.0, 0.0, 0.4)])
def test_outliers_long_motions_repetitions_and_equal_times_are_not_pairs(bad):
    row, (difference, motion, dt) = np.empty(noise.COLUMNS), bad
    noise.clear(row)
    before = row.copy()
    noise.add_pair(row, np.array([[difference, motion, 1.0, 1.0, 2.0], [0.0] * 5]), dt)
    np.testing.assert_array_equal(row, before)
    noise.add_pair(row, np.array([[59.0, 1.9, 1.0, 1.0, 2.0], [0.0] * 5]), 0.4)
    assert row[noise.PAIRS] == 1.0


def test_nis_and_autocorrelation_are_means_over_the_newest_scalars():
    rng, row = np.random.default_rng(5), np.zeros(noise.COLUMNS)
    u, nis = rng.normal(size=(400, 3)), rng.chisquare(3, 400)
    products = np.array([np.nan, *np.mean(u[1:] * u[:-1], axis=1)])
    for k in range(400):
        noise.add_innovation(row, nis[k], u[k] @ u[k - 1], 3, k > 0)
        if k + 1 <= 50:
            assert row[noise.NIS] == pytest.approx(np.mean(nis[: k + 1]) / 3.0)
        if 0 < k <= 100:
            assert row[noise.WHITENESS] == pytest.approx(np.mean(products[1 : k + 1]))
    # After that, each new value has a weight of 2 % (NIS) or 1 % (autocorrelation).
    expected = 0.02 * 0.98 ** np.arange(349, -1, -1) @ nis[50:] / 3.0 + 0.98**350 * np.mean(nis[:50]) / 3.0
    assert row[noise.NIS] == pytest.approx(expected)
    one = consistency_of(row, 0.0)
    assert (one.nis, one.numbers, one.autocorrelation) == (row[noise.NIS], 150, row[noise.WHITENESS] / row[noise.NIS])
    assert (one.low, one.high) == pytest.approx(tuple(chi2.ppf([0.025, 0.975], 150) / 150))
    assert one.alarm == pytest.approx(chi2.isf(1e-4, 150) / 150)
    assert one.bound == pytest.approx(1.96 / math.sqrt(300))


def test_the_nis_is_the_mean_of_accepted_innovations_over_their_deviations():
    numbers, P = options(filter="ekf"), np.diag([0.1, 0.2, 0.03])
    found = started(numbers, (1.0, 2.0, 3.1), P)
    found.noise[0, noise.SCALE], found.noise[0, noise.CHANNEL + noise.SCALE] = 4.0, 9.0
    S = P + R_FIX * np.diag([4.0, 4.0, 9.0])
    y = np.array([0.1, -0.2, 2.0 * math.pi - 6.2])
    assert ekf.take(found, numbers, fix(1.1, 1.8, -3.1, time=1.0)) == ACCEPTED
    assert found.noise[0, noise.NIS] == pytest.approx(np.mean(y**2 / np.diag(S)))
    np.testing.assert_allclose(found.x[:2], np.add((1.0, 2.0), (P @ np.linalg.solve(S, y))[:2]), rtol=1e-12)
    before = found.noise.copy()
    ekf.take(found, numbers, fix(90.0, time=2.0))
    np.testing.assert_array_equal(found.noise, before)
    # The rejected fix does not form a pair with the next fix either.
    x, y, theta = found.x
    ekf.take(found, numbers, fix(x, y, theta, time=3.0))
    assert found.noise[0, noise.WHITENESS_NUMBERS] == 0.0
    ekf.take(found, numbers, fix(x, y, theta, time=4.0))
    assert found.noise[0, noise.WHITENESS_NUMBERS] == 3.0


@pytest.mark.parametrize(("kind", "row", "c"), [("fixes", 0, 0.95), ("landmarks", 2, 0.5)])
def test_correlated_innovations_are_reported_only_if_the_filter_does_not_compensate_for_them(kind, row, c):
    def is_reported(**values):
        run = Run(kind, c, 0, **values)
        return consistency_of(run.row, run.options.times[row]).is_correlated

    def times(correlation):
        return {"correlation_times": (*[0.0] * row, -DT / math.log(correlation))}

    assert not is_reported()
    assert not is_reported(**times(c))
    assert is_reported(detect_correlation=False)
    assert is_reported(**times(0.1))


def test_the_fuzzy_rules_raise_q_for_a_drift_only_and_scale_positions_and_headings_separately():
    rows = np.zeros((2, noise.COLUMNS))
    for row, offset in zip(rows, (0.0, 2.0), strict=True):
        noise.clear(row)
        rng = np.random.default_rng(1)
        for _ in range(300):
            noise.add_drift(row, rng.normal(size=3) + offset, 3)
    assert noise.q_scale(rows[0]) < 1.5
    assert 3.0 < noise.q_scale(rows[1]) <= math.exp(4.0)
    numbers, rng = options(filter="ekf_fnn"), np.random.default_rng(6)
    found = started(numbers)
    for step in range(200):
        z = rng.normal(0.0, 0.17, 2)
        assert ekf.take(found, numbers, reading(POSITION_FIX, z, R_FIX[:2, :2], time=0.1 * step)) == ACCEPTED
    assert noise.scale_of(found.noise[0], True) == 1.0
    assert noise.scale_of(found.noise[0], False) == pytest.approx(1.0, abs=0.5)
