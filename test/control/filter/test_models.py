"""The filter's models: motions against fine integrations and sampling, derivatives against finite differences."""

import math

import numpy as np
import pytest
from filter_runs import wrapped
from hypothesis import given, settings
from hypothesis import strategies as st

from diffbot_control.filter.models import lateral_noise, linearisation_variance, move
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist

CHECK = settings(max_examples=60)
POSES = st.builds(Pose, st.floats(-10.0, 10.0), st.floats(-10.0, 10.0), st.floats(-3.0, 3.0))
TWISTS = st.builds(Twist, st.floats(-2.0, 2.0), st.floats(-3.0, 3.0))
TIMES = st.floats(0.01, 0.5)


def integrated(pose, twist, dt, steps=4000):
    """Follow the unicycle in fine steps of Euler's method about the middle of each."""
    theta = pose.theta + twist.omega * dt * (np.arange(steps) + 0.5) / steps
    way = twist.v * dt / steps
    end = pose.theta + twist.omega * dt
    return np.array([pose.x + way * np.cos(theta).sum(), pose.y + way * np.sin(theta).sum(), end])


def unwrapped(pose, near):
    """The pose as an array, its heading within half a turn of ``near``."""
    return np.array([pose.x, pose.y, near + wrapped(pose.theta - near)])


@CHECK
@given(POSES, TWISTS, TIMES)
def test_a_motion_is_the_arc_to_second_order(pose, twist, dt):
    found = move(pose, twist, dt).end
    assert -math.pi < found.theta <= math.pi
    # The chord is shorter than the way by a factor sin(a) / a, a half of the turn.
    bound = abs(twist.v) * dt * (0.5 * twist.omega * dt) ** 2 / 6.0
    away = unwrapped(found, pose.theta) - integrated(pose, twist, dt)
    assert np.hypot(*away[:2]) <= 1.01 * bound + 1e-7
    assert away[2] == pytest.approx(0.0, abs=1e-12)


def test_a_motion_across_the_robot_adds_its_variance_across():
    arc = move(Pose(1.0, 2.0, 0.5), Twist(0.7, 0.8), 0.1)
    across = np.array([-math.sin(0.54), math.cos(0.54)])
    xx, xy, yy = lateral_noise(arc, 0.1, 0.03)
    np.testing.assert_allclose([[xx, xy], [xy, yy]], 0.03 * np.outer(across, across), atol=1e-15)


def test_the_linearisation_error_by_sampling():
    rng, distance, sigma = np.random.default_rng(3), 2.0, 0.1
    along, across = sigma * rng.normal(size=(2, 100_000))
    ranges, bearings = np.hypot(distance - along, across), np.arctan2(-across, distance - along)
    left_out = np.array([np.mean((ranges - distance + along) ** 2), np.mean((bearings + across / distance) ** 2)])
    found = np.array(linearisation_variance(distance**2, 2.0 * sigma**2))
    # A bound, as all of the spread may lie across, and not wasteful.
    assert (left_out <= found).all()
    assert (found <= 5.0 * left_out).all()
