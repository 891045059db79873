"""Figures of merit, on paths made by hand."""

import math

import numpy as np
import pytest

from diffbot_core.geometry import Pose
from diffbot_tools.metrics import goal_metrics

# 3 m ahead, 4 m to the left, back by 1 m: a drive from (0, 0) to (3, 3).
TIME = np.array([10.0, 11.0, 12.5, 13.0, 14.0])
POSES = np.array([[0.0, 0.0, 0.0], [3.0, 0.0, 1.0], [3.0, 4.0, 1.5], [3.0, 3.2, 1.6], [3.0, 3.0, 1.5]])
GOAL = Pose(3.0, 3.1, 0.5 * math.pi)


def test_a_drive_by_hand():
    metrics = goal_metrics(TIME, POSES, GOAL, 0.2, 0.1)
    # The goal looks along +y: 0.1 m short of it is x = -0.1 in its frame.
    assert metrics.final == pytest.approx((-0.1, 0.0, 1.5 - 0.5 * math.pi), abs=1e-12)
    assert metrics.position_error == pytest.approx(0.1)
    assert metrics.heading_error == pytest.approx(0.5 * math.pi - 1.5)
    # Inside from 13.0 s on, 3 s after the first pose.
    assert metrics.settling_time == pytest.approx(3.0)
    assert metrics.path_length == pytest.approx(3.0 + 4.0 + 0.8 + 0.2)
    assert metrics.direct_distance == pytest.approx(math.hypot(3.0, 3.1))


def test_a_run_that_ends_outside_of_a_tolerance_has_not_settled():
    # |1.6 - pi/2| = 0.029, |1.5 - pi/2| = 0.071: at the end the heading is out again.
    assert math.isnan(goal_metrics(TIME, POSES, GOAL, 0.2, 0.05).settling_time)
    assert math.isnan(goal_metrics(TIME, POSES, GOAL, 0.05, 0.1).settling_time)
