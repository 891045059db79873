"""Fixes without a heading, as a GNSS receiver gives them: the heading is found by driving."""

import math

import numpy as np
import pytest
from filter_runs import Robot, gated_filter, winding, wrapped
from scipy.stats import chi2

from diffbot_control.filter.gate import ACCEPTED, REJECTED, RELOCATED
from diffbot_control.filter.localization import Localization
from diffbot_control.filter.localization_config import LocalizationConfig
from diffbot_control.filter.measurements import PositionFix
from diffbot_control.filter.measurements.fix import fix_of
from diffbot_core.geometry import Pose

R = np.diag([0.04, 0.04])


def position(robot, rng, stamp=0):
    x, y = robot.truth[:2] + rng.multivariate_normal(np.zeros(2), R)
    return PositionFix(stamp, x, y, R)


def test_a_fix_is_a_position_if_its_heading_has_a_deviation_of_pi_or_more():
    for sigma, expected in ((math.pi, "PositionFix"), (0.99 * math.pi, "PoseFix"), (1000.0, "PositionFix")):
        found = fix_of(5, Pose(1.0, 2.0, 3.0), np.diag([0.1, 0.2, sigma**2]))
        assert type(found).__name__ == expected
        assert found.z[:2].tolist() == [1.0, 2.0]
        assert found.R[:2, :2].tolist() == np.diag([0.1, 0.2]).tolist()


@pytest.mark.study
def test_the_filter_starts_without_a_heading_finds_it_and_knows_its_errors():
    nees, ends, late = [], [], []
    for run in range(40):
        rng, robot = np.random.default_rng([1, run]), Robot(np.random.default_rng([2, run]))
        robot.truth = np.array([3.0, -2.0, wrapped(0.6 * run)])
        pose, P = position(robot, rng).restart(Pose(0.0, 0.0, 0.0))
        assert (pose.theta, P[2, 2], P[:2, :2].tolist()) == (0.0, math.pi**2, R.tolist())
        found, squares = gated_filter("ekf", pose, P, gate_probability=1.0), []
        for step in range(600):
            found.predict(robot.move(*winding(step)))
            if step % 5 == 0:
                assert found.take(position(robot, rng)) == ACCEPTED
                squares.append(found.nis)
        error = found.memory.belief.x[:3] - robot.truth
        error[2] = wrapped(error[2])
        nees.append(error @ np.linalg.solve(found.memory.belief.P, error))
        ends.append(abs(error[2]))
        late += squares[60:]
    assert max(ends) < 0.25
    # Two degrees of freedom, once the heading is known: within 5 % of 2, which is five deviations of the mean.
    assert len(late) == 40 * 60
    assert abs(np.mean(late) / 2.0 - 1.0) < 0.05
    low, high = chi2.ppf([1e-3, 1.0 - 1e-3], 3 * len(nees))
    assert low < sum(nees) < high


def test_a_kidnapped_robot_is_back_with_the_third_position_and_its_heading_is_open():
    rng, robot = np.random.default_rng(3), Robot(np.random.default_rng(4))
    found, outcomes = gated_filter("ekf"), []
    for step in range(300):
        found.predict(robot.move(*winding(step)))
        if step == 204:
            robot.truth += (6.0, -4.0, 1.0)
        if step % 10 == 0:
            outcomes.append(found.take(position(robot, rng)))
            if outcomes[-1] == RELOCATED:
                assert 0.05 < found.memory.belief.P[2, 2] < 1.0, "found from three positions alone"
    assert outcomes[21:24] == [REJECTED, REJECTED, RELOCATED]
    assert set(outcomes[24:]) == {ACCEPTED}
    assert np.hypot(*(found.memory.belief.x[:2] - robot.truth[:2])) < 0.5


def test_the_localization_starts_from_a_position():
    found = Localization(LocalizationConfig())
    found.on_measurement(PositionFix(0, 1.0, 2.0, R))
    assert found.initialised
    assert found.estimate().P[2, 2] == math.pi**2
