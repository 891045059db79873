"""Errors that all measurements of landmarks have in common, as constants and as states."""

import math

import numpy as np
import pytest
from filter_runs import wrapped

from diffbot_control.filter.gated_filter import GatedFilter
from diffbot_control.filter.measurements import LandmarkMeasurement
from diffbot_control.filter.models import Motion
from diffbot_control.filter.options import FilterConfig, options_of
from diffbot_core.geometry import Point, Pose
from diffbot_core.kinematics import Twist, TwistCovariance

LANDMARK = Point(2.0, 1.5)
MARKS = (Point(4.0, 1.0), Point(-3.0, 4.0), Point(0.5, -4.0))
R = np.diag([0.04, 0.02]) ** 2
SIGMAS = {"landmark_range_offset_sigma": 0.1, "landmark_range_scale_sigma": 0.05, "landmark_bearing_offset_sigma": 0.05}


def measured(x, landmark=LANDMARK):
    """Range and bearing at the pose ``x[:3]``, measured by a sensor with the errors ``x[-3:]``."""
    dx, dy = landmark[0] - x[0], landmark[1] - x[1]
    offset, scale, turn = x[-3:]
    return np.array([(1.0 + scale) * math.hypot(dx, dy) + offset, math.atan2(dy, dx) - x[2] + turn])


def drive(seed, errors, *, estimated=True, **options):
    """Drive for 100 s past three landmarks; return the filter and the mean NEES of its pose after 20 s."""
    rng, dt = np.random.default_rng(seed), 0.2
    found = GatedFilter(options_of(FilterConfig(filter="ekf", **options), landmarks=estimated), 0.6)
    found.reset_to(Pose(0.0, 0.0, 0.0), np.diag([0.05, 0.05, 0.02]) ** 2)
    x, nees = rng.normal(scale=[0.05, 0.05, 0.02]), []
    for step in range(500):
        v, omega = 0.5, 0.6 * math.sin(step / 40.0)
        found.predict(Motion(Twist(v, omega), dt, TwistCovariance(4e-4, 0.0, 4e-4)))
        v, omega = v + rng.normal(0.0, 0.02), omega + rng.normal(0.0, 0.02)
        middle = x[2] + 0.5 * omega * dt
        x = x + np.array([v * dt * math.cos(middle), v * dt * math.sin(middle), omega * dt])
        if step % 5 == 0:
            mark = MARKS[rng.integers(3)]
            z = measured([*x, *errors], mark) + rng.normal(scale=[0.04, 0.02])
            found.take(LandmarkMeasurement(step, z[0], wrapped(z[1]), R, mark))
        if step >= 100:
            e = found.memory.belief.x[:3] - x
            e[2] = wrapped(e[2])
            nees.append(e @ np.linalg.solve(found.memory.belief.P[:3, :3], e))
    return found, np.mean(nees)


@pytest.mark.study
def test_the_errors_are_found_and_the_covariance_is_honest():
    """8 drives with errors drawn from the prior: NEES of pose and errors 3 each; without the states it is far more."""
    scales = np.array(list(SIGMAS.values()))
    pose, errors, blind = [], [], []
    for seed in range(8):
        truth = np.random.default_rng(100 + seed).normal(scale=scales)
        found, nees = drive(seed, truth, **SIGMAS, gate_probability=1.0)
        estimate = found.landmark_errors()
        away = estimate.errors - truth
        pose.append(nees)
        errors.append(away @ np.linalg.solve(estimate.P, away))
        blind.append(drive(seed, truth, estimated=False, gate_probability=1.0)[1])
    # 24 degrees of freedom: 99.8 % of the means are between the bounds; those of the pose are correlated in time.
    assert 1.0 < np.mean(errors) < 6.4
    assert 1.5 < np.mean(pose) < 5.6
    assert np.mean(blind) > 3.0 * np.mean(pose)
