"""The compiled filter against the filter itself: the same innovations, whatever the drive."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from diffbot_control.filter.measurements import Heading, LandmarkMeasurement, PositionFix
from diffbot_control.filter.measurements.wall import WallRange
from diffbot_control.filter.wall_map import WallMap
from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_core.errors import BadMessageError
from diffbot_core.geometry import Point, Pose, wrap_angle
from diffbot_core.schema import build
from diffbot_tools.calibration import settings as kernel
from diffbot_tools.calibration.events import Collector, averaged
from diffbot_tools.calibration.likelihood import run_events, settings_of
from diffbot_tools.calibration.quantities import given_prior
from diffbot_tools.calibration.simulation import Errors, record
from diffbot_tools.refilter.filter_run import RecordingLocalization

PLACES = (Point(4.0, 1.0), Point(-3.0, 5.0))
WIDE = {
    "detect_correlation": False,
    "wheel_radius_sigma": 0.05,
    "wheel_separation_sigma": 0.05,
    "wheel_radius_walk": 1e-3,
    "landmark_gate": "weigh",
    "left_radius_error": 0.01,
    "wheel_separation_error": -0.02,
}
LANDMARKS = {
    "landmark_range_offset": 0.02, "landmark_range_offset_sigma": 0.1, "landmark_range_scale_sigma": 0.03,
    "landmark_bearing_offset_sigma": 0.02, "landmark_correlation_time": 1.0,
}  # fmt: skip


@pytest.fixture(scope="module")
def recording():
    return record(Errors(0.03, -0.02, 0.04), seed=3, seconds=20.0)


def others(recording):
    """Headings, and landmarks: both numbers, a range or a bearing, one of twenty misread."""
    rng, found = np.random.default_rng(5), []
    for index, fix in enumerate(recording.fixes[1:-1]):
        x, y, theta = fix.pose
        stamp = fix.stamp + 30_000_000
        found.append(Heading(stamp, wrap_angle(theta + 0.05 * rng.normal()), np.array([[0.0025]])))
        place = PLACES[index % 2]
        distance = math.hypot(place.x - x, place.y - y) + 0.1 * rng.normal()
        bearing = wrap_angle(math.atan2(place.y - y, place.x - x) - theta + 0.05 * rng.normal())
        R = np.diag((0.01, 0.0025))
        if index % 5 == 1:
            R[0, 0] = math.inf
        elif index % 5 == 3:
            R[1, 1] = math.inf
        elif index % 20 == 0:
            distance += 3.0
        found.append(LandmarkMeasurement(stamp, distance, bearing, R, place))
    return found


CASES = {
    "fixes": ({}, 1),
    "motion noise, delay": ({"odometry_noise": "motion", "odometry_delay": 0.2, "fix_correlation_time": 2.0}, 4),
    "density, delay within a message": (
        {
            "odometry_noise": "density",
            "odometry_delay": 0.13,
            "odometry_covariance_scale": 2.0,
            "heading_correlation_time": 1.0,
        },
        10,
    ),
    "landmarks alone": ({"odometry_covariance_scale": 4.0, **LANDMARKS}, 10**6),
}


@pytest.mark.parametrize("case", CASES)
def test_innovations_are_those_of_the_filter(recording, case):
    options, keep = CASES[case]
    config = build(EkfNodeConfig, WIDE | options)
    measured = [one for index, one in enumerate(recording.fixes) if index % keep == 0] + others(recording)
    measured.sort(key=lambda one: one.stamp)
    filtered, collector = RecordingLocalization(config), Collector()
    for target in (filtered, collector):
        waiting = list(measured)
        for step in recording.odometry:
            while waiting and waiting[0].stamp <= step.stamp:
                target.on_measurement(waiting.pop(0))
            target.on_odometry(step)
    found = run_events(collector.events(case), given_prior(config), settings_of(config)._replace(split=True))
    rows = found.result[found.result[:, kernel.NUMBERS] > 0]
    expected = filtered.innovations
    assert len(rows) == len(expected) > 180
    np.testing.assert_allclose(rows[:, kernel.NIS], [one.nis for one in expected], rtol=1e-7, atol=1e-10)
    for row, one in zip(rows, expected, strict=True):
        m = len(one.y)
        np.testing.assert_allclose(row[kernel.INNOVATION : kernel.INNOVATION + m], one.y, atol=1e-9)
        white = np.linalg.solve(np.linalg.cholesky(one.S), one.y)
        np.testing.assert_allclose(row[kernel.WHITE : kernel.WHITE + m], white, atol=1e-7)
    belief = filtered.filter.memory.belief
    # The pose is that of the last measurement here; the constant states stay until the end of the drive.
    constant = slice(3, len(belief.x))
    np.testing.assert_allclose(found.x[constant], belief.x[constant], atol=1e-9)
    rest = (belief.P - np.diag(np.diag(belief.P)))[constant, constant]
    np.testing.assert_allclose((found.P - np.diag(np.diag(found.P)))[constant, constant], rest, rtol=1e-6, atol=1e-12)


def test_term_is_the_gaussian_density_of_the_innovation_with_scaled_deviations(recording):
    """Of each innovation, by scipy, from y and S of the filter, to which the scaled covariances are given."""
    config = build(EkfNodeConfig, WIDE | {"gate_probability": 1.0})
    filtered, collector = RecordingLocalization(config), Collector()
    scale = np.diag([2.0, 2.0, 3.0])
    pairs = zip(recording.odometry[::2], recording.odometry[1::2], strict=True)
    for index, (fix, pair) in enumerate(zip(recording.fixes, pairs, strict=False)):
        # The first one, at which the filter starts, keeps what it claims.
        filtered.on_measurement(replace(fix, R=scale @ fix.R @ scale) if index else fix)
        collector.on_measurement(fix)
        for step in pair:
            filtered.on_odometry(step)
            collector.on_odometry(step)
    settings = settings_of(config)._replace(xy_factor=2.0, yaw_factor=3.0)
    found = run_events(collector.events("gauss"), given_prior(config), settings)
    expected = [stats.multivariate_normal(np.zeros(3), one.S).logpdf(one.y) for one in filtered.innovations]
    rows = found.result[found.result[:, kernel.NUMBERS] > 0]
    np.testing.assert_allclose(rows[:, kernel.TERM], expected, rtol=1e-8)


def test_averaged_odometry_keeps_the_way_and_its_variance(recording):
    collector = Collector()
    for fix in recording.fixes:
        collector.on_measurement(fix)
    for step in recording.odometry:
        collector.on_odometry(step)
    fine = collector.events("fine")
    coarse = averaged(fine, 0.5)
    for events in (fine, coarse):
        np.testing.assert_allclose(events.odometry.start[1:], events.odometry.end[:-1])
    assert len(coarse.odometry.end) == 40
    sums = []
    for events in (fine, coarse):
        dt = (events.odometry.end - events.odometry.start)[:, None]
        way, variance = events.odometry.twist * dt, events.odometry.covariance * dt * dt
        sums.append([*way.sum(axis=0), *variance.sum(axis=0)])
    np.testing.assert_allclose(sums[0], sums[1])


def test_a_drive_may_start_from_a_position_and_what_the_kernel_does_not_know_is_dropped():
    collector, walls = Collector(), WallMap((5.0,), (-1.0,), (5.0,), (1.0,)).walls()
    with pytest.raises(BadMessageError, match="no fix yet"):
        collector.on_measurement(Heading(0, 0.1, np.eye(1)))
    collector.on_measurement(PositionFix(0, 1.0, 2.0, np.diag([0.04, 0.09])))
    (start,) = collector.resets
    assert start.pose == Pose(1.0, 2.0, 0.0)
    np.testing.assert_allclose(start.R, np.diag([0.04, 0.09, math.pi**2]))
    with pytest.raises(BadMessageError, match="not used by the calibration"):
        collector.on_measurement(WallRange(1, 4.0, np.eye(1), Pose(0.0, 0.0, 0.0), walls))
