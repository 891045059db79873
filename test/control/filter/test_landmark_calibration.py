"""Errors that all measurements of landmarks have in common, as constants and as states."""

import math
from dataclasses import replace

import numpy as np
import pytest
from filter_runs import SEPARATION, Robot, landmark, wrapped

from diffbot_control.filter.gated_filter import GatedFilter
from diffbot_control.filter.options import FilterConfig, options_of
from diffbot_core.geometry import Pose

MARKS = ((4.0, 1.0), (-3.0, 4.0), (0.5, -4.0))
DEVIATIONS, START = (0.04, 0.02), (0.05, 0.05, 0.02)
SIGMAS = {"landmark_range_offset_sigma": 0.1, "landmark_range_scale_sigma": 0.05, "landmark_bearing_offset_sigma": 0.05}


def drive(seed, errors, *, estimated=True, **options):
    """Drive for 100 s past three landmarks; return the filter and the mean NEES of its pose after 20 s."""
    rng, (offset, scale, turn) = np.random.default_rng(seed), errors
    robot, nees = Robot(rng, dt=0.2), []
    robot.truth = rng.normal(scale=START)
    found = GatedFilter(options_of(FilterConfig(filter="ekf", **options), landmarks=estimated), SEPARATION)
    found.reset_to(Pose(0.0, 0.0, 0.0), np.diag(START) ** 2)
    for step in range(500):
        found.predict(robot.move(0.5, 0.6 * math.sin(step / 40.0) + 0.01))
        if step % 5 == 0:
            seen = landmark(robot.truth, MARKS[rng.integers(3)], np.diag(DEVIATIONS) ** 2)
            z = np.array(((1.0 + scale) * seen.range + offset, seen.bearing + turn)) + rng.normal(scale=DEVIATIONS)
            found.take(replace(seen, stamp=step, range=z.item(0), bearing=wrapped(z.item(1))))
        if step >= 100:
            e = found.memory.belief.x[:3] - robot.truth
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
