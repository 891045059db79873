"""Absolute measurements: their times, errors, dropouts and outliers."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from noise_rows import noise_row

from diffbot_core.geometry import Pose
from diffbot_sim import sensors
from diffbot_sim.config import SensorConfig
from diffbot_sim.noise import FIX, FIX_FAULT, FURTHER, LANDMARKS, NoiseSource
from diffbot_sim.sensors import NO_ERRORS

TRUTH = Pose(4.0, -3.0, 3.1)


def test_a_rate_that_divides_the_steps_is_exact_after_a_million_steps():
    assert [step for step in range(10**6, 10**6 + 3000) if sensors.is_due(step, 1.0, 0.001)] == [
        1_000_000,
        1_001_000,
        1_002_000,
    ]


@settings(max_examples=100)
@given(st.floats(0.1, 50.0), st.sampled_from((0.01, 0.02, 0.1, 0.15)))
def test_any_rate_is_kept_on_average_with_even_gaps(rate, sampling_time):
    per_step = min(rate * sampling_time, 1.0)
    found = [step for step in range(2000) if sensors.is_due(step, rate, sampling_time)]
    assert abs(len(found) - 2000 * per_step) <= 1.0 + 1e-6
    gaps = np.diff(found)
    if len(gaps):
        assert gaps.max() <= math.ceil(1.0 / per_step - 1e-6)
        assert gaps.min() >= max(math.floor(1.0 / per_step + 1e-6), 1)


@pytest.mark.parametrize(
    ("delay", "sampling_time", "steps"),
    [(0.0, 0.1, 0), (0.05, 0.1, 1), (0.7, 0.1, 7), (0.30001, 0.1, 4), (60.0, 0.001, 60000)],
)
def test_a_measurement_arrives_at_the_first_step_after_its_delay(delay, sampling_time, steps):
    assert sensors.delay_in_steps(delay, sampling_time) == steps


def noises(*purposes, count=2000, run=0):
    """Return the noise (count, purposes, 4) of a run."""
    return NoiseSource().run(12, run, count, purposes).swapaxes(0, 1)


@pytest.mark.parametrize(("x", "y", "share"), [(0.0, 0.0, 0.0), (0.3, -0.4, 0.25), (9.0, 9.0, 1.0)])
def test_position_errors_decrease_towards_the_origin_within_eps_xy_distance(x, y, share):
    config = SensorConfig(eps_xy_max=0.3, eps_theta_max=0.17, eps_xy_distance=2.0)
    fix = sensors.measured_fix(Pose(x, y, 0.5), NO_ERRORS, noise_row(0.5, -1.0, 1.0, purpose=FIX), config).pose
    assert fix == pytest.approx((x + 0.15 * share, y - 0.3 * share, 0.67), abs=1e-12)
    assert sensors.fix_variances(config) == sensors.fix_variances(config._replace(eps_xy_distance=0.0))


def test_a_range_is_at_least_a_millimetre():
    config, low = SensorConfig(landmark_range_error_max=0.5), noise_row(-1.0, purpose=LANDMARKS)
    found = [sensors.measured_landmark(Pose(0.0, 0.0, 0.0), 0, at, 0.0, low, config)[0] for at in (0.0, 0.5, 0.6)]
    assert found == pytest.approx([1e-3, 1e-3, 0.1])


def test_lost_fixes_and_outliers_have_their_shares_and_outliers_their_distance():
    config = SensorConfig(0.0, 0.0, 0.0, fix_dropout=0.2, fix_outlier=0.3)
    fixes = [sensors.measured_fix(TRUTH, NO_ERRORS, noise, config) for noise in noises(FIX, FIX_FAULT)]
    lost, off = np.array([(fix.lost, fix.pose != TRUTH) for fix in fixes]).T
    assert (lost.mean(), off.mean(), (lost & off).mean()) == pytest.approx((0.2, 0.3, 0.06), abs=0.04)
    away = np.array([(fix.pose.x - 4.0, fix.pose.y + 3.0) for fix in fixes if fix.pose != TRUTH])
    np.testing.assert_allclose(np.hypot(*away.T), 3.0)
    assert np.abs(away.mean(axis=0)).max() < 0.4, "in all directions"
    assert {fix.pose.theta for fix in fixes} == {TRUTH.theta}


def fixes_of(config, run, count):
    """Return the fixes of a run that stands at the origin."""
    errors, found = NO_ERRORS, []
    for noise in noises(FIX, count=count, run=run):
        found.append(sensors.measured_fix(Pose(0.0, 0.0, 0.0), errors, noise, config))
        errors = found[-1].errors
    return found


@pytest.mark.parametrize("correlation", [0.0, 0.9])
def test_correlated_errors_have_a_constant_variance_and_a_geometric_autocorrelation(correlation):
    config = SensorConfig(eps_xy_max=0.3, eps_theta_max=0.1, fix_noise_correlation=correlation)
    bounds = np.array((0.3, 0.3, 0.1))
    errors = np.array([[one.pose for one in fixes_of(config, run, 8)] for run in range(1000)])
    # 1000 independent samples for each fix, with at most the kurtosis of a normal distribution.
    np.testing.assert_allclose(errors.var(axis=0) / (bounds**2 / 3.0), 1.0, atol=4.0 * math.sqrt(2.0 / 1000))
    scaled = errors / (bounds / math.sqrt(3.0))
    for lag in (1, 2, 5):
        assert (scaled[:, lag:] * scaled[:, :-lag]).mean() == pytest.approx(correlation**lag, abs=0.06)
    assert abs((scaled[:, :, 0] * scaled[:, :, 1]).mean()) < 0.07
    assert (np.abs(errors) <= math.sqrt((1.0 + correlation) / (1.0 - correlation)) * bounds).all()


def test_turn_rates_are_measured_at_their_rate_but_not_at_step_0():
    assert not sensors.is_gyro_due(0, SensorConfig(gyro_rate=10.0), 0.1)
    assert [step for step in range(7) if sensors.is_gyro_due(step, SensorConfig(gyro_rate=5.0), 0.1)] == [2, 4, 6]


def test_noise_is_independent_for_each_purpose_and_run_and_does_not_depend_on_the_first_step():
    source, whole = NoiseSource(), NoiseSource().run(7, 3, 50, (FIX, FURTHER))
    for first, count in ((0, 1), (17, 9), (49, 1)):
        part = np.full((FURTHER + 1, count, 4), 0.25)
        source.rows(7, 3, first, part, (FURTHER, FIX))
        np.testing.assert_array_equal(part[[FIX, FURTHER]], whole[[FIX, FURTHER], first : first + count])
        assert (part[FIX_FAULT] == 0.25).all(), "not drawn"
    # NumPy's Philox increments its counter before it computes numbers.
    bits = np.random.Philox(key=np.array([7, 3], dtype=np.uint64), counter=[17, FIX, 0, 0])
    np.testing.assert_array_equal(np.random.Generator(bits).random(4), whole[FIX, 17])
    runs = [source.run(7, run, 500, (FIX,))[FIX].ravel() for run in (3, 4)]
    others = [source.run(8, 3, 500, (FIX,))[FIX].ravel(), source.run(7, 3, 500, (FURTHER,))[FURTHER].ravel()]
    assert np.abs(np.corrcoef([*runs, *others]) - np.eye(4)).max() < 0.1
