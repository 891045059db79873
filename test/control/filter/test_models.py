"""The filter's models: noise across the motion by hand, the linearisation error by sampling."""

import math

import numpy as np
import pytest

from diffbot_control.filter.models import lateral_noise, linearisation_variance, move
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist


def test_a_motion_across_the_robot_adds_its_variance_across():
    arc = move(Pose(1.0, 2.0, 0.5), Twist(0.7, 0.8), 0.1)
    across = np.array([-math.sin(0.54), math.cos(0.54)])
    xx, xy, yy = lateral_noise(arc, 0.1, 0.03)
    np.testing.assert_allclose([[xx, xy], [xy, yy]], 0.03 * np.outer(across, across), atol=1e-15)


def test_a_motion_past_half_a_turn_is_wrapped():
    assert move(Pose(0.0, 0.0, 3.0), Twist(0.7, 0.8), 0.5).end.theta == pytest.approx(3.4 - 2.0 * math.pi)


def test_the_linearisation_error_by_sampling():
    rng, distance, sigma = np.random.default_rng(3), 2.0, 0.1
    along, across = sigma * rng.normal(size=(2, 100_000))
    ranges, bearings = np.hypot(distance - along, across), np.arctan2(-across, distance - along)
    left_out = np.array([np.mean((ranges - distance + along) ** 2), np.mean((bearings + across / distance) ** 2)])
    found = np.array(linearisation_variance(distance**2, 2.0 * sigma**2))
    # A bound, as all of the spread may lie across, and not wasteful.
    assert (left_out <= found).all()
    assert (found <= 5.0 * left_out).all()
