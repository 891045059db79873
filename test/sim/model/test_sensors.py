"""Absolute measurements: when they come, how wrong they are, and how often they fail."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from diffbot_core.geometry import Pose
from diffbot_sim.model import sensors
from diffbot_sim.model.philox import Draw, NoiseKey, draw
from diffbot_sim.model.sensors import NO_ERRORS, SensorConfig

TRUTH = Pose(4.0, -3.0, 3.1)


def test_a_whole_ratio_is_exact_for_long():
    assert [step for step in range(10**6, 10**6 + 3000) if sensors.due(step, 1.0, 0.001)] == [
        1_000_000,
        1_001_000,
        1_002_000,
    ]


@settings(max_examples=100)
@given(st.floats(0.1, 50.0), st.sampled_from((0.01, 0.02, 0.1, 0.15)))
def test_any_rate_is_kept_on_average_and_evenly(rate, sampling_time):
    per_step = min(rate * sampling_time, 1.0)
    found = [step for step in range(2000) if sensors.due(step, rate, sampling_time)]
    assert abs(len(found) - 2000 * per_step) <= 1.0 + 1e-6
    gaps = np.diff(found)
    if len(gaps):
        assert gaps.max() <= math.ceil(1.0 / per_step - 1e-6)
        assert gaps.min() >= max(math.floor(1.0 / per_step + 1e-6), 1)


@pytest.mark.parametrize(
    ("delay", "sampling_time", "steps"),
    [(0.0, 0.1, 0), (0.05, 0.1, 1), (0.7, 0.1, 7), (0.14, 0.02, 7), (0.30001, 0.1, 4), (60.0, 0.001, 60000)],
)
def test_a_measurement_arrives_with_the_first_step_not_before_its_time(delay, sampling_time, steps):
    assert sensors.delay_in_steps(delay, sampling_time) == steps


def noises(count=2000, block=1):
    return [draw(12, 0, step, block) for step in range(count)]


def assert_uniform(errors, *bounds):
    """Each column is within its bound, with the variance of a uniform error, and independent of the others."""
    errors = np.array(errors).reshape(len(errors), -1)
    assert (np.abs(errors) <= np.multiply(bounds, 1.0 + 1e-9)).all()
    np.testing.assert_allclose(errors.mean(axis=0), 0.0, atol=4.0 * max(bounds) / math.sqrt(3.0 * len(errors)))
    np.testing.assert_allclose(errors.var(axis=0), [sensors.uniform_variance(bound) for bound in bounds], rtol=0.09)
    assert np.abs(np.atleast_2d(np.corrcoef(errors.T)) - np.eye(len(bounds))).max() < 0.1


def test_errors_are_uniform_within_their_bounds_and_independent_of_each_other():
    config = SensorConfig(eps_x_max=0.3, eps_y_max=0.2, eps_theta_max=0.17, gyro_error_max=0.04, gyro_bias=-0.1)
    errors = []
    for step, noise in enumerate(noises()):
        fix, key = sensors.measured_pose(TRUTH, noise, config), NoiseKey(12, 0, step)
        turns = fix.theta - 3.1, sensors.measured_heading(TRUTH, noise, config) - 3.1
        rate = sensors.turn_rate_at(key, 0.7, config) - 0.7 + 0.1
        errors.append((fix.x - 4.0, fix.y + 3.0, *(math.remainder(one, math.tau) for one in turns), rate))
        assert -math.pi < fix.theta <= math.pi
    assert_uniform(errors, 0.3, 0.2, 0.17, 0.087, 0.04)


@pytest.mark.parametrize(("x", "y", "share"), [(0.0, 0.0, 0.0), (0.3, -0.4, 0.25), (-2.0, 0.0, 1.0), (9.0, 9.0, 1.0)])
def test_position_errors_may_shrink_towards_the_origin(x, y, share):
    config = SensorConfig(eps_x_max=0.3, eps_y_max=0.2, eps_theta_max=0.17, eps_xy_distance=2.0)
    fix = sensors.measured_pose(Pose(x, y, 0.5), Draw(0.5, -1.0, 1.0, 0.0), config)
    assert fix == pytest.approx((x + 0.15 * share, y - 0.2 * share, 0.67), abs=1e-12)
    assert sensors.fix_variances(config) == sensors.fix_variances(config._replace(eps_xy_distance=0.0))


def test_a_range_is_never_below_a_millimetre():
    config, low = SensorConfig(landmark_range_error_max=0.5), Draw(-1.0, 0.0, 0.0, 0.0)
    found = [sensors.measured_landmark(Pose(0.0, 0.0, 0.0), at, 0.0, low, config)[0] for at in (0.0, 0.5, 0.6)]
    assert found == pytest.approx([1e-3, 1e-3, 0.1])


@pytest.mark.parametrize("share", [0.0, 0.2, 1.0])
def test_the_shares_of_lost_fixes_and_outliers_and_their_distance_and_direction(share):
    config = SensorConfig(fix_dropout=share, fix_outlier=share, fix_outlier_distance=3.0)
    faults = noises(block=2)
    fixes = [sensors.with_outlier(TRUTH, fault, config) for fault in faults]
    both = np.array([(sensors.is_lost(one, config), fix != TRUTH) for one, fix in zip(faults, fixes, strict=True)])
    assert both.mean(axis=0) == pytest.approx(share, abs=0.04 * (share % 1.0 > 0.0))
    assert both.all(axis=1).mean() == pytest.approx(share**2, abs=0.03 * (share % 1.0 > 0.0))
    away = np.array([(fix.x - 4.0, fix.y + 3.0) for fix in fixes if fix != TRUTH]).reshape(-1, 2)
    np.testing.assert_allclose(np.hypot(*away.T), 3.0)
    assert not share or np.abs(away.mean(axis=0)).max() < 0.4, "in all directions"
    assert {fix.theta for fix in fixes} == {TRUTH.theta}


def fixes_of(config, run, count):
    """Fixes of one run, all at the same true pose."""
    errors, found = NO_ERRORS, []
    for step in range(count):
        found.append(sensors.fix_at(NoiseKey(11, run, step), Pose(0.0, 0.0, 0.0), errors, config))
        errors = found[-1].errors
    return found


@pytest.mark.parametrize("correlation", [0.0, 0.9])
def test_correlated_errors_have_the_same_variance_at_every_fix_and_decay_geometrically(correlation):
    config = SensorConfig(eps_x_max=0.3, eps_y_max=0.6, eps_theta_max=0.1, fix_noise_correlation=correlation)
    bounds = np.array((0.3, 0.6, 0.1))
    errors = np.array([[one.pose for one in fixes_of(config, run, 8)] for run in range(1000)])
    # The runs are independent: 1000 samples for each fix; the kurtosis is at most a normal one's.
    np.testing.assert_allclose(errors.var(axis=0) / (bounds**2 / 3.0), 1.0, atol=4.0 * math.sqrt(2.0 / 1000))
    scaled = errors / (bounds / math.sqrt(3.0))
    for lag in (1, 2, 5):
        assert (scaled[:, lag:] * scaled[:, :-lag]).mean() == pytest.approx(correlation**lag, abs=0.06)
    assert abs((scaled[:, :, 0] * scaled[:, :, 1]).mean()) < 0.07
    assert (np.abs(errors) <= math.sqrt((1.0 + correlation) / (1.0 - correlation)) * bounds).all()


def test_the_random_delay_is_uniform_and_changes_neither_the_errors_nor_their_number():
    found = fixes_of(SensorConfig(fix_delay=0.1, fix_delay_jitter=0.4), 0, 2000)
    assert_uniform([one.delay - 0.3 for one in found], 0.2)
    assert [one.errors for one in found] == [one.errors for one in fixes_of(SensorConfig(), 0, 2000)]
    assert not any(one.lost for one in found)


def test_turn_rates_come_at_their_rate_over_the_steps_before():
    assert not sensors.turn_rate_due(0, SensorConfig(gyro_rate=10.0), 0.1)
    assert [step for step in range(7) if sensors.turn_rate_due(step, SensorConfig(gyro_rate=5.0), 0.1)] == [2, 4, 6]
