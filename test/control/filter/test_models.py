"""Arcs, linearisation variance of landmarks and derivatives of the turn rate; test_ekf.py checks the other models."""

import numpy as np
import pytest
from filter_runs import (
    ROWS,
    SEPARATION,
    body_twist,
    build_motion,
    covariance,
    jacobian,
    reading,
    wrapped,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from diffbot_control.filter import models
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist

CHECK = settings(max_examples=100)
POSES = st.tuples(st.floats(-10.0, 10.0), st.floats(-10.0, 10.0), st.floats(-3.1, 3.1))
TWISTS = st.tuples(st.floats(-2.0, 2.0), st.floats(-3.0, 3.0), st.floats(0.01, 0.5))


@CHECK
@given(POSES, TWISTS)
def test_a_motion_is_the_arc_to_second_order(pose, motion):
    v, omega, dt = motion
    turned = pose[2] + omega * dt * (np.arange(1000) + 0.5) / 1000
    x, y, theta = models.move(Pose(*pose), Twist(v, omega), dt)
    away = complex(x - pose[0], y - pose[1]) - v * dt * np.exp(1j * turned).mean()
    assert abs(away) <= abs(v * dt) * (omega * dt) ** 2 / 24.0 + 1e-6
    assert wrapped(theta - pose[2] - omega * dt) == pytest.approx(0.0, abs=1e-9)


KINDS = [(kind, n) for kind in (models.POSE_FIX, models.POSITION_FIX, models.HEADING) for n in (3, 10)]
KINDS += [(kind, 10) for kind in (models.LANDMARK, models.RANGE, models.BEARING)]


@pytest.mark.parametrize(
    ("kind", "scale"), [(models.LANDMARK, 0.0), (models.LANDMARK, 0.5), (models.RANGE, 0.5), (models.BEARING, 0.0)]
)
def test_the_linearisation_variance_is_an_upper_bound_but_at_most_five_times_too_large(kind, scale):
    rng, distance, sigma, m = np.random.default_rng(3), 2.0, 0.1, len(ROWS[kind])
    x, P = np.zeros(10), np.diag([sigma**2] * 2 + [0.0] * 8)
    x[8] = scale
    one = reading(kind, np.zeros(m), np.zeros((m, m)), at=(distance, 0.0))
    found = models.expect(one, x, P).R
    along, across = sigma * rng.normal(size=(2, 100_000))
    ranges, bearings = (1.0 + scale) * np.hypot(distance - along, across), np.arctan2(-across, distance - along)
    variances = np.mean(
        [(ranges - (1.0 + scale) * (distance - along)) ** 2, (bearings + across / distance) ** 2], axis=1
    )
    assert (variances[ROWS[kind]] <= np.diag(found)).all()
    assert (np.diag(found) <= 5.0 * variances[ROWS[kind]]).all()
    np.testing.assert_array_equal(found, np.diag(np.diag(found)))


def test_the_turn_rate_is_linearised_at_the_combined_twist_of_wheels_and_gyro():
    rng = np.random.default_rng(7)
    for _ in range(20):
        x, M = np.zeros(10), covariance(rng, 2, 0.05, 0.3)
        x[6] = rng.normal(0.0, 0.1)
        rate = models.TurnRate(rng.normal(), rng.uniform(1e-3, 0.1))
        motion = build_motion(*rng.normal(size=2), 0.1, M[0, 0], M[0, 1], M[1, 1], rate=rate)
        found = models.rate_expectation(x, motion, SEPARATION)
        assert found.y == pytest.approx(rate.value - x[6] - motion.twist.omega)
        assert found.variance == pytest.approx(rate.variance + M[1, 1])
        combined = build_motion(*body_twist(x, motion)[0], 0.1, 0.0, 0.0, 0.0)
        expected = jacobian(lambda s: np.array([body_twist(s, combined)[0][1] + s[6]]), x)  # noqa: B023
        np.testing.assert_allclose(found.H, expected, atol=1e-8)
