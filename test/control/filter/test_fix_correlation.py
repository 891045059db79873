"""Fixes whose errors last: the default filter finds out from the fixes, and its covariance stays honest."""

import math

import numpy as np
import pytest
from filter_runs import R_FIX, Robot, fix, gated_filter, wrapped

from diffbot_control.filter.fix_correlation import correlation_of, new_fix_correlation
from diffbot_control.filter.options import FilterConfig, options_of
from diffbot_core.geometry import Pose

SIGMAS = np.sqrt(R_FIX.diagonal())


class Run:
    """40 s at 10 Hz with a fix at 5 Hz; the NEES after 10 s."""

    def __init__(self, c, seed, **options):
        rng = np.random.default_rng(seed)
        self.found, robot = gated_filter("ekf", **options), Robot(rng, noise=0.06)
        noise = rng.normal(size=3)
        robot.truth = -SIGMAS * noise  # the filter starts at the first fix, which is coloured, too
        self.nees, self.square = [], []
        for step in range(400):
            self.found.predict(robot.move(0.5 + 0.2 * math.sin(0.05 * step), 0.4 * math.sin(0.03 * step + 0.01)))
            if step % 2 == 0:
                noise = c * noise + math.sqrt(1.0 - c * c) * rng.normal(size=3)
                x, y, theta = robot.truth + SIGMAS * noise
                self.found.take(fix(x, y, wrapped(theta)))
            if step >= 100:
                belief = self.found.memory.belief
                e = belief.x[:3] - robot.truth
                e[2] = wrapped(e[2])
                self.nees.append(e @ np.linalg.solve(belief.P[:3, :3], e))
                self.square.append(e[0] ** 2 + e[1] ** 2)


def together(c, runs=8, **options):
    """Mean NEES and RMSE [m] over runs, and the mean correlation found."""
    done = [Run(c, seed, **options) for seed in range(runs)]
    factors = np.array([one.found.memory.fix_correlation.inflation for one in done])
    found = ((factors - 1.0) / (factors + 1.0)).mean()
    return np.mean([one.nees for one in done]), math.sqrt(np.mean([one.square for one in done])), found


@pytest.mark.study
@pytest.mark.parametrize(("c", "blind"), [(0.5, 5.0), (0.9, 12.0)])
def test_the_covariance_is_honest_with_coloured_fixes(c, blind):
    nees, rmse, found = together(c)
    without, rmse_without, _ = together(c, detect_correlation=False)
    assert 1.0 < nees < 6.0
    assert without > blind
    assert rmse < 1.05 * rmse_without
    assert found == pytest.approx(c, abs=0.2)


@pytest.mark.study
def test_with_white_fixes_nothing_changes():
    nees, rmse, found = together(0.0)
    without, rmse_without, _ = together(0.0, detect_correlation=False)
    assert nees == pytest.approx(without, rel=0.1)
    assert rmse == pytest.approx(rmse_without, rel=0.02)
    assert found < 0.05


def test_the_option_and_the_other_mechanisms_switch_it_off():
    assert options_of(FilterConfig()).detects_fix_correlation
    assert not options_of(FilterConfig(detect_correlation=False)).detects_fix_correlation
    assert not options_of(FilterConfig(fix_correlation_time=1.0)).detects_fix_correlation
    assert not options_of(FilterConfig(filter="ekf_fnn")).detects_fix_correlation
    assert not options_of(FilterConfig(filter="ekf_fnn_calibrating")).detects_fix_correlation
    found = Run(0.9, 0).found
    assert found.memory.fix_correlation.inflation > 3.0
    found.reset_to(Pose(9.0, 9.0, 0.0), R_FIX)
    assert found.memory.fix_correlation.inflation > 3.0, "it survives a relocation"
    found.reset()
    assert found.memory.fix_correlation == new_fix_correlation()
    told = Run(0.9, 0, fix_correlation_time=-0.2 / math.log(0.9)).found
    assert told.memory.fix_correlation == new_fix_correlation()


@pytest.mark.parametrize("c", [0.3, 0.6, 0.9])
def test_right_means_give_the_correlation(c):
    # Of noise with variance R: half the squared difference 1 - c, the product of neighbours c.
    assert correlation_of(1.0 - c, 0.0, c, 200) == pytest.approx(c)
    assert correlation_of(1.0 - c + 0.1, 0.1, c, 200) == pytest.approx(c)
    assert correlation_of(0.1 * (1.0 - c), 0.0, 0.1 * c, 200) == pytest.approx(c)  # R claimed ten times as large
    assert correlation_of(1.0 - c, 0.0, 0.0, 200) == 0.0  # white fixes of too large a claimed R
    assert correlation_of(1.0, 0.0, c, 200) == 0.0  # a drift
    assert correlation_of(1.0 - c, 0.0, c, 1) == 0.0  # too few
