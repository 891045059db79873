"""Landmarks whose errors last: the default filter finds out how long, and its covariance stays honest."""

import math
from dataclasses import replace

import numpy as np
import pytest
from filter_runs import R_FIX, SEPARATION, Robot, landmark, numbers_of, wrapped

from diffbot_control.filter.gated_filter import GatedFilter
from diffbot_control.filter.landmark_correlation import NO_PAIRS, Pair, compared, with_pair
from diffbot_control.filter.options import FilterConfig, options_of
from diffbot_core.geometry import Pose
from diffbot_core.units import NS_PER_S

PLACES = (4.0, 4.0), (-4.0, 4.0), (-4.0, -4.0), (4.0, -4.0), (0.0, 7.0)
SIGMAS = np.array((0.06, 0.03))
DT = 0.2


class Run:
    """40 s at 5 Hz, all landmarks at each step; the NEES after 16 s."""

    def __init__(self, time, seed, **options):
        rng = np.random.default_rng(seed)
        robot = Robot(rng, noise=0.06, dt=DT)
        robot.truth = np.array((1.0, 0.0, 3.0))
        self.found = GatedFilter(options_of(FilterConfig(**options), landmarks=True), SEPARATION)
        self.found.reset_to(Pose(*robot.truth), 1e-4 * R_FIX)
        c = math.exp(-DT / time) if time else 0.0
        errors = rng.normal(size=(len(PLACES), 2))
        self.nees, self.square = [], []
        for step in range(1, 200):
            self.found.predict(robot.move(0.5, 0.3))
            errors = c * errors + math.sqrt(1.0 - c * c) * rng.normal(size=errors.shape)
            for place, error in zip(PLACES, errors, strict=True):
                seen = landmark(robot.truth, place, np.diag(SIGMAS**2))
                distance, bearing = (numbers_of(seen) + SIGMAS * error).tolist()
                stamp = round(step * DT * NS_PER_S)
                self.found.take(replace(seen, stamp=stamp, range=distance, bearing=wrapped(bearing)))
            if step >= 80:
                belief = self.found.memory.belief
                e = belief.x[:3] - robot.truth
                e[2] = wrapped(e[2])
                self.nees.append(e @ np.linalg.solve(belief.P[:3, :3], e))
                self.square.append(e[0] ** 2 + e[1] ** 2)


def together(time, runs=3, **options):
    """Mean NEES, RMSE [m] and mean of the time found [s] over runs."""
    done = [Run(time, seed, **options) for seed in range(runs)]
    found = np.mean([one.found.memory.landmarks.means.time for one in done])
    return np.mean([one.nees for one in done]), math.sqrt(np.mean([one.square for one in done])), found


@pytest.mark.study
@pytest.mark.parametrize(("time", "blind"), [(0.5, 6.0), (3.0, 12.0)])
def test_the_covariance_is_honest_with_errors_that_last(time, blind):
    nees, rmse, found = together(time)
    without, rmse_without, _ = together(time, detect_correlation=False)
    assert 1.0 < nees < 5.0
    assert without > blind
    assert rmse < 1.05 * rmse_without
    assert found == pytest.approx(time, rel=0.3)


@pytest.mark.study
def test_with_independent_errors_nothing_changes():
    nees, rmse, found = together(0.0)
    without, rmse_without, _ = together(0.0, detect_correlation=False)
    assert nees == pytest.approx(without, rel=0.1)
    assert rmse == pytest.approx(rmse_without, rel=0.02)
    assert found < 0.1


def test_what_was_found_survives_a_relocation_but_no_landmark_has_a_partner():
    found = Run(3.0, 0).found
    means = found.memory.landmarks.means
    found.reset_to(Pose(9.0, 9.0, 0.0), R_FIX)
    assert found.memory.landmarks.means == means
    assert not found.memory.landmarks.seen
    found.reset()
    assert found.landmark_correlation_time() == 0.0


def test_a_pair_is_compared_by_its_own_covariance():
    y, before = np.array((0.3, -0.1)), np.array((0.1, 0.1))
    H, R = np.array([[0.6, -0.8, 0.0], [0.16, 0.12, -1.0]]), np.diag((0.04, 0.01))
    shift, spread = np.array((0.1, 0.05, 0.02)), (0.002, 0.001)
    pair = compared(y, before, H, R, shift, spread, 0.5)
    residual = y - before + H @ shift
    weight = np.linalg.inv(R)
    assert pair.difference == pytest.approx(residual @ weight @ residual / 4.0)
    moved = H @ np.diag((spread[0], spread[0], spread[1])) @ H.T
    assert pair.motion == pytest.approx(np.trace(moved @ weight) / 4.0)
    assert (pair.product, pair.square) == pytest.approx((before @ weight @ y / 2.0, y @ weight @ y / 2.0))
    assert (pair.numbers, pair.dt) == (2, 0.5)


@pytest.mark.parametrize(("motion", "c"), [(0.0, 0.8), (0.05, 0.85), (0.5, 0.9)])
def test_the_motion_explains_half_of_the_difference_at_most(motion, c):
    """White noise and c of it, and odometry that claims more noise than the measurements show."""
    means = NO_PAIRS
    for _ in range(300):
        means = with_pair(means, Pair(0.2, motion, 2.0, 2.2, 2, 0.4))
    assert means.pairs == 200
    assert math.exp(-0.4 / means.time) == pytest.approx(c)


@pytest.mark.parametrize(("difference", "motion"), [(40.0, 0.0), (0.2, 1.5)])
def test_an_outlier_or_a_long_way_has_no_partner(difference, motion):
    assert with_pair(NO_PAIRS, Pair(difference, motion, 1.0, 1.0, 2, 0.4)) == NO_PAIRS
