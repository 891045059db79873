"""Absolute measurements: when they come, how wrong they are, and how often they fail."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import kstest

from diffbot_core.geometry import Pose
from diffbot_sim.model import sensors
from diffbot_sim.model.philox import Draw, NoiseKey, draw
from diffbot_sim.model.sensors import NO_ERRORS, SensorConfig

DEFAULT = SensorConfig()
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


def noises(count=4000, block=1):
    return [draw(12, 0, step, block) for step in range(count)]


def test_errors_of_a_fix_fill_their_bounds_evenly():
    config = SensorConfig(eps_x_max=0.3, eps_y_max=0.2, eps_theta_max=0.17)
    fixes = [sensors.measured_pose(TRUTH, noise, config) for noise in noises()]
    errors = np.array([(fix.x - 4.0, fix.y + 3.0, math.remainder(fix.theta - 3.1, 2.0 * math.pi)) for fix in fixes])
    for column, bound in zip(errors.T, (0.3, 0.2, 0.17), strict=True):
        assert np.abs(column).max() <= bound * (1.0 + 1e-12)
        assert kstest(column, "uniform", (-bound, 2.0 * bound)).pvalue > 1e-3
    assert np.abs(np.corrcoef(errors.T) - np.eye(3)).max() < 0.07
    assert all(-math.pi < fix.theta <= math.pi for fix in fixes)
    variances = [sensors.uniform_variance(bound) for bound in (0.3, 0.2, 0.17)]
    np.testing.assert_allclose(errors.var(axis=0), variances, rtol=0.06)


@pytest.mark.parametrize(("x", "y", "share"), [(0.0, 0.0, 0.0), (0.3, -0.4, 0.25), (-2.0, 0.0, 1.0), (9.0, 9.0, 1.0)])
def test_position_errors_may_shrink_towards_the_origin(x, y, share):
    config = SensorConfig(eps_x_max=0.3, eps_y_max=0.2, eps_theta_max=0.17, eps_xy_distance=2.0)
    fix = sensors.measured_pose(Pose(x, y, 0.5), Draw(0.5, -1.0, 1.0, 0.0), config)
    assert fix == pytest.approx((x + 0.15 * share, y - 0.2 * share, 0.67), abs=1e-12)
    assert sensors.fix_variances(config) == sensors.fix_variances(config._replace(eps_xy_distance=0.0))


def test_errors_of_the_heading_fill_theirs_and_are_not_those_of_the_fix():
    assert sensors.measured_heading(Pose(1.0, 2.0, 0.5), Draw(0.0, 0.0, 0.0, -0.5), DEFAULT) == pytest.approx(
        0.5 - 0.0435
    )
    headings = [sensors.measured_heading(TRUTH, noise, DEFAULT) for noise in noises()]
    errors = np.array([math.remainder(heading - 3.1, 2.0 * math.pi) for heading in headings])
    assert np.abs(errors).max() <= 0.087 * (1.0 + 1e-12)
    assert kstest(errors, "uniform", (-0.087, 0.174)).pvalue > 1e-3
    assert all(-math.pi < heading <= math.pi for heading in headings)
    of_fix = [
        math.remainder(sensors.measured_pose(TRUTH, noise, DEFAULT).theta - 3.1, 2.0 * math.pi) for noise in noises()
    ]
    assert abs(np.corrcoef(errors, of_fix)[0, 1]) < 0.07


def test_a_range_is_never_below_a_millimetre():
    config = SensorConfig(landmark_range_error_max=0.5)
    for distance in (0.0, 0.2, 0.5):
        assert (
            sensors.measured_landmark(Pose(0.0, 0.0, 0.0), distance, 0.0, Draw(-1.0, 0.0, 0.0, 0.0), config)[0] == 1e-3
        )
    found = sensors.measured_landmark(Pose(0.0, 0.0, 0.0), 0.6, 0.0, Draw(-1.0, 0.0, 0.0, 0.0), config)
    assert found[0] == pytest.approx(0.1)


@pytest.mark.parametrize("share", [0.0, 0.2, 1.0])
def test_the_shares_of_lost_fixes_and_outliers_and_their_distance_and_direction(share):
    config = SensorConfig(fix_dropout=share, fix_outlier=share, fix_outlier_distance=3.0)
    faults = noises(block=2)
    lost = [sensors.is_lost(fault, config) for fault in faults]
    fixes = [sensors.with_outlier(TRUTH, fault, config) for fault in faults]
    thrown = [fix for fix in fixes if fix != TRUTH]
    spread = 4.5 * math.sqrt(4000 * share * (1.0 - share))
    assert abs(sum(lost) - 4000 * share) <= spread
    assert abs(len(thrown) - 4000 * share) <= spread
    for fix in thrown:
        assert math.hypot(fix.x - 4.0, fix.y + 3.0) == pytest.approx(3.0)
        assert fix.theta == TRUTH.theta
    if thrown:
        angles = [math.atan2(fix.y + 3.0, fix.x - 4.0) for fix in thrown]
        assert kstest(angles, "uniform", (-math.pi, 2.0 * math.pi)).pvalue > 1e-3
    if 0.0 < share < 1.0:
        both = np.array([(one, fix != TRUTH) for one, fix in zip(lost, fixes, strict=True)], float)
        assert abs(np.corrcoef(both.T)[0, 1]) < 0.07


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
    errors = np.array([[one.pose for one in fixes_of(config, run, 12)] for run in range(2000)])
    for axis, bound in enumerate((0.3, 0.6, 0.1)):
        # The runs are independent: 2000 samples for each fix; the kurtosis is at most a normal one's.
        variance = errors[:, :, axis].var(axis=0)
        assert variance == pytest.approx(np.full(12, bound**2 / 3.0), rel=4.0 * math.sqrt(2.0 / 2000))
        scaled = errors[:, :, axis] / math.sqrt(bound**2 / 3.0)
        for lag in (1, 2, 5):
            product = (scaled[:, lag:] * scaled[:, :-lag]).mean()
            assert product == pytest.approx(correlation**lag, abs=0.07)
    assert abs((errors[:, :, 0] * errors[:, :, 1]).mean()) / (0.3 * 0.6 / 3.0) < 0.07
    assert np.abs(errors[:, 0]).max() <= 0.6  # the first is uniform
    largest = math.sqrt((1.0 + correlation) / (1.0 - correlation))
    assert np.abs(errors / (0.3, 0.6, 0.1)).max() <= largest


def test_the_random_delay_is_uniform_and_independent_of_the_errors():
    config = SensorConfig(fix_delay=0.1, fix_delay_jitter=0.4)
    found = fixes_of(config, 0, 5000)
    delays = np.array([one.delay for one in found])
    assert kstest(delays, "uniform", (0.1, 0.4)).pvalue > 1e-3
    assert abs(np.corrcoef(delays[1:], delays[:-1])[0, 1]) < 0.06
    # Neither do the errors change with it, nor is a fix lost.
    assert [one.errors for one in found] == [one.errors for one in fixes_of(SensorConfig(), 0, 5000)]
    assert not any(one.lost for one in found)


def test_a_turn_rate_has_the_bias_and_an_error_that_fills_its_bound_and_is_that_of_no_other_sensor():
    config = SensorConfig(gyro_error_max=0.04, gyro_bias=-0.1)
    keys = [NoiseKey(3, 0, step) for step in range(4000)]
    errors = np.array([sensors.turn_rate_at(key, 0.7, config) - 0.7 + 0.1 for key in keys])
    assert kstest(errors / 0.04, "uniform", args=(-1.0, 2.0)).pvalue > 1e-3
    for block in range(5):
        others = np.array([draw(3, 0, step, block) for step in range(4000)])
        assert np.abs(np.corrcoef(errors, others.T)[0, 1:]).max() < 0.06
    assert not sensors.turn_rate_due(0, SensorConfig(gyro_rate=10.0), 0.1)
    assert [step for step in range(7) if sensors.turn_rate_due(step, SensorConfig(gyro_rate=5.0), 0.1)] == [2, 4, 6]
