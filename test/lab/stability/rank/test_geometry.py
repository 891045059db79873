"""Random points and moves are inside the bounds of the geometry of a step, which are not much wider."""

import math

import numpy as np
import pytest

from diffbot_lab.stability.interval.outward import wrapped
from diffbot_lab.stability.rank.geometry import bearing_error, goal_after_move, measured_distance

ROUNDING = 1e-12
EPS = 0.3


def test_measured_goals_of_a_disc_are_within_the_bearing_error_and_the_distances():
    rng = np.random.default_rng(1)
    for _ in range(200):
        low = rng.uniform(0.35, 3.0)
        high, d0 = low + 0.05, rng.uniform(-bearing_error(EPS, low), bearing_error(EPS, low) - 0.02)
        near, far = measured_distance(EPS, low, high, d0, d0 + 0.02)
        found = []
        for _ in range(100):
            rho, angle, radius = rng.uniform(low, high), rng.uniform(-math.pi, math.pi), EPS * math.sqrt(rng.random())
            x, y = rho + radius * math.cos(angle), radius * math.sin(angle)
            assert abs(math.atan2(y, x)) <= bearing_error(EPS, low)
            if d0 <= math.atan2(y, x) <= d0 + 0.02:
                found.append(math.hypot(x, y))
        assert all(near <= one <= far for one in found)


def test_goals_after_random_moves_are_inside_their_bounds():
    rng = np.random.default_rng(2)
    for _ in range(300):
        rho, u, a = rng.uniform(0.3, 5.0), rng.uniform(-0.2, 0.2), rng.uniform(-math.pi, math.pi)
        near, far, turned0, turned1 = goal_after_move(rho, rho + 0.02, u, u + 0.01, a, a + 0.03)
        for share in rng.uniform(size=(20, 3)):
            r, length, angle = rho + 0.02 * share[0], u + 0.01 * share[1], a + 0.03 * share[2]
            # The goal is at (r, 0); the robot moves by the length at this angle.
            x, y = r - length * math.cos(angle), length * math.sin(angle)
            assert near <= math.hypot(x, y) <= far
            assert turned0 <= math.atan2(y, x) <= turned1
        assert far - near < 0.02 + 0.01 + 0.2 * 0.03 + 1e-3


def test_an_interval_across_the_cut_is_wrapped_in_two_parts():
    low, high = math.pi - 0.1, math.pi + 0.2
    assert wrapped(low, high, 0) == pytest.approx((low, math.pi))
    assert wrapped(low, high, 1) == pytest.approx((-math.pi, 0.2 - math.pi))
    empty = wrapped(low, high, -1)
    assert empty[0] > empty[1]
