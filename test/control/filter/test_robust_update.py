"""Corrections weaker than R says: errors that last, inflated as a Markov process; landmarks beyond the gate."""

import math
from dataclasses import replace

import numpy as np
import pytest
from filter_runs import covariance, gated_filter, landmark, wrapped
from scipy.linalg import solve_toeplitz

from diffbot_control.filter.correlation import inflation_after
from diffbot_control.filter.ekf import PoseEkf, Robust
from diffbot_control.filter.gate import ACCEPTED, WEIGHED
from diffbot_control.filter.gated_filter import GatedFilter
from diffbot_control.filter.measurements import (
    FIXES,
    LANDMARKS,
    PoseFix,
)
from diffbot_control.filter.options import WEIGH, FilterConfig, options_of
from diffbot_core.errors import InvalidValueError
from diffbot_core.geometry import Point, Pose

X0 = np.array([0.4, -0.3, 0.7])
R_FIX = np.diag([0.04, 0.05, 0.01])
LANDMARK = Point(4.0, 1.0)
P0 = covariance(np.random.default_rng(3), 3, 0.05, 0.2)


def textbook(P, H, R, y, weight=1.0, inflation=1.0):
    """Joint update written anew: the gain of an inflated R, and a part of it."""
    S = H @ P @ H.T + inflation * R
    K = P @ H.T @ np.linalg.inv(S)
    return weight * K @ y, P - weight * K @ S @ K.T


def exact(pose, point=LANDMARK, away=(0.0, 0.0), stamp=0):
    """Return range and bearing, wrong by ``away``."""
    seen = landmark(pose, point, np.diag((0.01, 0.0025)))
    return replace(seen, stamp=stamp, range=seen.range + away[0], bearing=wrapped(seen.bearing + away[1]))


def landmark_rows(x, point=LANDMARK):
    dx, dy = point.x - x[0], point.y - x[1]
    d = math.hypot(dx, dy)
    return np.array([[-dx / d, -dy / d, 0.0], [dy / d**2, -dx / d**2, -1.0]]), d


def linearisation(P, d):
    spread = P[0, 0] + P[1, 1]
    return spread**2 / (2 * d**2), spread**2 / d**4


@pytest.mark.parametrize("inflation", [1.0, 19.0])
@pytest.mark.parametrize("gate", [math.inf, 0.5])
def test_the_gain_is_that_of_the_inflated_noise_times_the_weight(inflation, gate):
    ekf, P = PoseEkf(), P0
    ekf.set_state(X0, P)
    y = np.array([0.3, -0.4, 0.2])
    S = P + R_FIX
    plain = y @ np.linalg.solve(S, y)
    weight = min(1.0, gate / plain)
    assert ekf.correct(PoseFix(0, Pose(*(X0 + y)), R_FIX), Robust(inflation, gate)) == pytest.approx(plain)
    shift, after = textbook(P, np.eye(3), R_FIX, y, weight, inflation)
    np.testing.assert_allclose(ekf.x, X0 + shift, rtol=1e-10)
    np.testing.assert_allclose(ekf.P, after, rtol=1e-9)
    np.testing.assert_allclose(ekf.newest.S, S)
    assert weight < 1.0 or gate == math.inf


def test_landmarks_beyond_the_gate_are_weighed_and_those_within_are_not():
    P, (H, d) = P0, landmark_rows(X0)
    for away, outcome in (((0.1, 0.02), ACCEPTED), ((8.0, 0.5), WEIGHED)):
        found = gated_filter("ekf", X0, P, landmark_gate=WEIGH)
        measured = exact(X0, away=away)
        R = measured.R + np.diag(linearisation(P, d))
        S = H @ P @ H.T + R
        nis = np.array(away) @ np.linalg.solve(S, away)
        assert found.take(measured) == outcome
        shift, after = textbook(P, H, R, np.array(away), min(1.0, 13.815510557964274 / nis))
        np.testing.assert_allclose(found.memory.belief.x, X0 + shift, rtol=1e-9)
        np.testing.assert_allclose(found.memory.belief.P, after, rtol=1e-8)


@pytest.mark.parametrize("kind", ["landmark", "fix"])
def test_the_inflation_depends_on_the_time_since_the_last_measurement_of_the_same_source(kind):
    times = {LANDMARKS: 2.0, FIXES: 2.0}
    found = GatedFilter(options_of(FilterConfig("ekf", gate_probability=1.0, fix_correlation_time=2.0)), 0.6, times)
    found.reset_to(Pose(*X0), P0)
    fix = PoseFix(10**9, Pose(*X0), R_FIX)
    # The fix that the filter starts from counts.
    found.start_from(fix)
    found.take(exact(X0, stamp=10**9))
    found.take(exact(X0, Point(-3.0, 2.0), stamp=2 * 10**9))
    (x, P), c = found.memory.belief, math.exp(-1.5 / 2.0)
    if kind == "fix":
        found.take(replace(fix, stamp=2_500_000_000))
        H, R = np.eye(3), R_FIX
    else:
        found.take(exact(X0, away=(0.1, 0.02), stamp=2_500_000_000))
        H, d = landmark_rows(x)
        R = np.diag([0.01, 0.0025]) + np.diag(linearisation(P, d))
    _, after = textbook(P, H, R, np.zeros(len(R)), inflation=(1.0 + c) / (1.0 - c))
    np.testing.assert_allclose(found.memory.belief.P, after, rtol=1e-8)


def test_the_adaptation_of_r_and_a_correlation_time_exclude_each_other():
    with pytest.raises(InvalidValueError, match="fix_correlation_time = 2"):
        FilterConfig(filter="ekf_fnn", fix_correlation_time=2.0).check()
    FilterConfig(filter="ekf_fnn", landmark_correlation_time=2.0).check()


@pytest.mark.parametrize(("dt", "time"), [(0.2, 0.3), (0.5, 2.0), (1.0, 0.1)])
def test_in_the_long_run_the_measurements_tell_as_much_as_independent_ones_with_the_inflated_variance(dt, time):
    # Best linear estimate of a constant from n errors of variance 1: its information is 1' V^-1 1.
    n = 2000
    information = solve_toeplitz(np.exp(-dt / time) ** np.arange(n), np.ones(n)).sum() / n
    assert inflation_after(dt, time) == pytest.approx(1.0 / information, rel=0.02)
