"""What measurements say about their own noise: simulated errors of known size and correlation, and plain means."""

import math

import numpy as np
import pytest
from filter_drives import DT, Run, markov
from filter_runs import R_FIX, build_motion, fix, options, reading, started
from scipy.linalg import solve_toeplitz
from scipy.stats import binom, chi2, norm

from diffbot_control.filter import ekf, noise, state
from diffbot_control.filter.consistency import consistency_of
from diffbot_control.filter.ekf import ACCEPTED
from diffbot_control.filter.models import POSITION_FIX
from diffbot_core.geometry import Pose


def statistic(rng, c):
    """Return the row of a source of which 200 pairs of errors are known, without a filter."""
    row, errors = np.zeros(noise.COLUMNS), markov(rng, c, 3)
    noise.clear(row)
    before = next(errors)
    for _ in range(200):
        y = next(errors)
        columns = 0.5 * (y - before) ** 2, 0.0 * y, y * before, y**2, np.ones(3)
        noise.add_pair(row, np.array([[one[:2].sum() for one in columns], [one[2] for one in columns]]), DT)
        before = y
    noise.update_scale_and_time(row)
    return row


@pytest.mark.parametrize("c", [0.5, 0.8, 0.95])
def test_the_correlation_is_found_within_the_deviation_of_an_estimate_from_so_many_errors(c):
    rng = np.random.default_rng(1)
    rows = [statistic(rng, c) for _ in range(40)]
    found, deviation = [noise.assumed_correlation(row, 0.0) for row in rows], math.sqrt((1.0 - c * c) / 600.0)
    np.testing.assert_allclose([row[noise.TIME] for row in rows], -DT / np.log(found))
    assert np.std(found) < 1.5 * deviation
    assert np.mean(found) == pytest.approx(c, abs=4.0 * deviation / math.sqrt(40) + (1.0 + 3.0 * c) / 600.0)


def test_of_white_errors_of_the_right_size_no_more_scales_and_correlations_are_found_than_by_chance():
    rng = np.random.default_rng(2)
    rows = np.array([statistic(rng, 0.0) for _ in range(150)])
    assert (rows[:, noise.TIME] > 0.0).sum() <= binom.ppf(0.999, 150, norm.sf(2.0))
    assert (rows[:, [noise.SCALE, noise.CHANNEL + noise.SCALE]] != 1.0).sum() <= binom.ppf(
        0.999, 300, 2.0 * norm.sf(3.0)
    )


@pytest.mark.parametrize("c", [0.3, 0.6, 0.9])
def test_right_means_give_the_correlation(c):
    def found(difference, motion, product, pairs=200.0):
        row = np.zeros(noise.COLUMNS)
        row[: noise.CHANNEL] = row[noise.CHANNEL : 2 * noise.CHANNEL] = (
            difference,
            motion,
            product,
            1.0,
            pairs,
            pairs,
            1.0,
        )
        row[noise.PERIOD] = DT
        noise.update_scale_and_time(row)
        return noise.assumed_correlation(row, 0.0)

    # Of noise with variance R: half the squared difference 1 - c, the product of neighbours c.
    assert found(1.0 - c, 0.0, c) == pytest.approx(c)
    assert found(1.0 - c + 0.1, 0.1, c) == pytest.approx(c)
    assert found(0.1 * (1.0 - c), 0.0, 0.1 * c) == pytest.approx(c), "R claimed ten times as large"
    assert found(1.0 - c, 0.0, 0.0) == 0.0, "white fixes of too large a claimed R"
    assert found(1.0, 0.0, c) == 0.0, "a drift"
    assert found(1.0 - c, 0.0, c, 1.0) == 0.0, "too few"


@pytest.mark.parametrize(("position", "angle"), [(10.0, 1.0), (1.0, 10.0), (0.1, 0.1), (0.1, 10.0)])
def test_too_small_a_claim_of_white_fixes_is_found_for_position_and_heading_apart_and_too_large_a_one_left(
    position, angle
):
    runs = [Run("fixes", 0.0, seed, (position, angle), 0.01, gate_probability=1.0) for seed in range(8)]
    found = np.exp(np.mean([np.log(one.scales()) for one in runs], axis=0))
    # Neighbours share a number: the mean of 200 has a deviation of 12 %, that of eight runs 4 %.
    np.testing.assert_allclose(found, (max(position, 1.0), max(angle, 1.0)), rtol=0.15)
    assert sum(one.correlation() > 0.0 for one in runs) <= binom.ppf(0.999, 8, norm.sf(2.0))


def test_white_fixes_of_the_right_size_leave_the_filter_as_it_is():
    runs = [Run("fixes", 0.0, seed) for seed in range(20)]
    assert sum(one.correlation() > 0.0 for one in runs) <= binom.ppf(0.999, 20, norm.sf(2.0))
    assert sum((one.scales() != 1.0).any() for one in runs) <= binom.ppf(0.999, 20, 4.0 * norm.sf(3.0))
    assert np.mean([one.nees for one in runs]) == pytest.approx(3.0, abs=0.6)


def test_what_was_corrected_with_too_small_an_r_is_inflated_when_that_is_found():
    numbers, rng = options(filter="ekf", gate_probability=1.0), np.random.default_rng(2)
    found = started(numbers, P=1e6 * R_FIX)
    for step in range(100):
        x, y, theta = math.sqrt(10.0) * np.sqrt(R_FIX.diagonal()) * rng.normal(size=3)
        ekf.take(found, numbers, fix(x, y, theta, time=0.2 * step))
    # The mean of 100 fixes of ten times R. If the first ones counted ten times as much, it would be 0.53 of that.
    assert 0.9 < found.P[0, 0] / (10.0 * R_FIX[0, 0] / 100.0) < 1.7


def test_landmarks_are_never_scaled_below_1_but_above():
    assert (Run("landmarks", 0.0, 0, (0.1, 0.1)).scales() == 1.0).all()
    found = Run("landmarks", 0.0, 0, (10.0, 4.0), gate_probability=1.0).scales()
    np.testing.assert_allclose(found, (10.0, 4.0), rtol=0.3)


@pytest.mark.study
@pytest.mark.parametrize(
    ("kind", "c", "seeds", "within"),
    [("fixes", 0.5, 8, 0.05), ("fixes", 0.9, 8, 0.05), ("fixes", 0.98, 8, 0.05), ("landmarks", 0.93, 2, 0.03)],
)
def test_the_covariance_is_honest_with_errors_that_last(kind, c, seeds, within):
    runs, blind = ([Run(kind, c, seed, detect_correlation=on) for seed in range(seeds)] for on in (True, False))
    nees, without = (np.mean([one.nees for one in which]) for which in (runs, blind))
    assert 1.0 < nees < 5.0
    assert without > 2.0 * nees
    rmse, rmse_blind = (math.sqrt(np.mean([one.squares for one in which])) for which in (runs, blind))
    assert rmse < 1.05 * rmse_blind
    assert np.mean([one.correlation() for one in runs]) == pytest.approx(c, abs=within)


def test_a_source_that_repeats_its_value_is_not_taken_for_a_precise_one():
    numbers = options(filter="ekf")
    found = started(numbers)
    for step in range(100):
        ekf.predict(found, numbers, build_motion(0.0, 0.0, 0.1, 1e-6, 0.0, 1e-6))
        ekf.take(found, numbers, fix(0.0, time=0.1 * step))
    assert noise.scale_of(found.noise[0], False) == noise.scale_of(found.noise[0], True) == 1.0
    assert np.linalg.inv(found.P)[0, 0] <= 101.0 / R_FIX[0, 0]


def test_what_was_found_survives_a_new_pose_but_no_reset():
    run = Run("fixes", 0.9, 0)
    learnt = run.row[: noise.NIS].copy()
    state.start(run.found, Pose(9.0, 9.0, 0.0), R_FIX)
    np.testing.assert_array_equal(run.row[: noise.NIS], learnt)
    assert not run.row[noise.NIS :].any()
    # The first fix after that has no partner: it is not taken for a jump of the error.
    ekf.take(run.found, run.options, fix(9.0, 9.0, time=99.0))
    assert run.row[noise.WHITENESS_NUMBERS] == 0.0
    state.reset(run.found, run.options)
    assert (run.correlation(), run.scales().tolist()) == (0.0, [1.0, 1.0])


def test_with_a_known_time_neither_scale_nor_correlation_is_sought_and_r_is_that_of_the_long_run():
    run, c = Run("fixes", 0.9, 0, correlation_times=(2.0,)), math.exp(-0.7 / 2.0)
    assert (run.scales().tolist(), run.row[noise.TIME]) == ([1.0, 1.0], 0.0)
    found = started(run.options)
    ekf.take(found, run.options, fix(0.0, time=1.0))
    P = found.P.copy()
    ekf.take(found, run.options, fix(0.0, time=1.7))
    np.testing.assert_allclose(found.P, P - P @ np.linalg.inv(P + R_FIX * (1.0 + c) / (1.0 - c)) @ P, atol=1e-12)


@pytest.mark.parametrize("detect", [True, False])
def test_with_a_known_time_the_assumed_correlation_is_that_of_the_period(detect):
    run = Run("fixes", 0.9, 0, correlation_times=(2.0,), detect_correlation=detect)
    found = consistency_of(run.row, 2.0)
    assert found.assumed == pytest.approx(math.exp(-DT / 2.0), abs=0.01)


@pytest.mark.parametrize(("dt", "time"), [(0.2, 0.3), (0.5, 2.0), (1.0, 0.1)])
def test_the_inflation_is_that_of_the_best_estimate_of_a_constant(dt, time):
    # Its information from n errors of variance 1 is 1' V^-1 1.
    n = 2000
    information = solve_toeplitz(np.exp(-dt / time) ** np.arange(n), np.ones(n)).sum() / n
    assert noise.inflation_after(dt, time) == pytest.approx(1.0 / information, rel=0.02)
    assert noise.inflation_after(dt, 0.0) == 1.0


@pytest.mark.parametrize("bad", [(61.0, 0.0, 0.4), (0.2, 2.5, 0.4), (0.2, 0.0, 0.0), (0.0, 0.0, 0.4)])
def test_an_outlier_a_long_way_the_same_time_or_a_repetition_makes_no_pair(bad):
    row, (difference, motion, dt) = np.empty(noise.COLUMNS), bad
    noise.clear(row)
    before = row.copy()
    noise.add_pair(row, np.array([[difference, motion, 1.0, 1.0, 2.0], [0.0] * 5]), dt)
    np.testing.assert_array_equal(row, before)
    noise.add_pair(row, np.array([[59.0, 1.9, 1.0, 1.0, 2.0], [0.0] * 5]), 0.4)
    assert row[noise.PAIRS] == 1.0


def test_nis_and_autocorrelation_are_plain_means_at_first_and_fade_then():
    rng, row = np.random.default_rng(5), np.zeros(noise.COLUMNS)
    u, nis = rng.normal(size=(400, 3)), rng.chisquare(3, 400)
    products = np.array([np.nan, *np.mean(u[1:] * u[:-1], axis=1)])
    for k in range(400):
        noise.add_innovation(row, nis[k], u[k] @ u[k - 1], 3, k > 0)
        if k + 1 <= 50:
            assert row[noise.NIS] == pytest.approx(np.mean(nis[: k + 1]) / 3.0)
        if 0 < k <= 100:
            assert row[noise.WHITENESS] == pytest.approx(np.mean(products[1 : k + 1]))
    # Then each is 2 % (1 %) of the mean, and fades by as much with each that follows.
    expected = 0.02 * 0.98 ** np.arange(349, -1, -1) @ nis[50:] / 3.0 + 0.98**350 * np.mean(nis[:50]) / 3.0
    assert row[noise.NIS] == pytest.approx(expected)
    expected = 0.01 * 0.99 ** np.arange(298, -1, -1) @ products[101:] + 0.99**299 * np.mean(products[1:101])
    assert row[noise.WHITENESS] == pytest.approx(expected)
    one = consistency_of(row, 0.0)
    assert (one.nis, one.numbers, one.autocorrelation) == (row[noise.NIS], 150, row[noise.WHITENESS] / row[noise.NIS])
    assert (one.low, one.high) == pytest.approx(tuple(chi2.ppf([0.025, 0.975], 150) / 150))
    assert one.alarm == pytest.approx(chi2.isf(1e-4, 150) / 150)
    assert one.bound == pytest.approx(1.96 / math.sqrt(300))


def test_only_accepted_innovations_count_each_over_its_own_deviation():
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
    # The rejected fix is no partner of the next one either.
    x, y, theta = found.x
    ekf.take(found, numbers, fix(x, y, theta, time=3.0))
    assert found.noise[0, noise.WHITENESS_NUMBERS] == 0.0
    ekf.take(found, numbers, fix(x, y, theta, time=4.0))
    assert found.noise[0, noise.WHITENESS_NUMBERS] == 3.0


@pytest.mark.parametrize("kind", ["fixes", "landmarks"])
@pytest.mark.parametrize("c", [0.5, 0.95])
def test_it_warns_of_correlated_errors_only_if_it_does_not_allow_for_them(kind, c):
    def warned(**values):
        run = Run(kind, c, 0, **values)
        row = 2 if kind == "landmarks" else 0
        return consistency_of(run.row, run.options.times[row]).is_correlated

    def times(correlation):
        return {"correlation_times": (*[0.0] * (2 if kind == "landmarks" else 0), -DT / math.log(correlation))}

    assert not warned()
    assert not warned(**times(c))
    assert warned(detect_correlation=False)
    assert warned(**times(0.1))


def test_a_drift_raises_q_but_not_r_and_positions_leave_the_scale_of_headings():
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
