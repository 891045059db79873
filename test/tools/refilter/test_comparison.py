"""Figures of a run against cases computed by hand."""

import math

import numpy as np
import pytest

from diffbot_control.filter.gated_filter import Belief
from diffbot_control.filter.localization import FilterEstimate
from diffbot_core.errors import DiffbotError
from diffbot_core.geometry import Pose
from diffbot_tools.refilter.comparison import consistency_of, errors_of
from diffbot_tools.refilter.filter_run import Innovation
from diffbot_tools.trajectory import Trajectory

SECOND = 10**9
P = np.diag([0.04, 0.01, 0.0025])


def estimate(stamp, *pose):
    return FilterEstimate(stamp, Pose(*pose), P, None, Belief(np.array(pose), P))


def test_gaps_and_times_outside_are_left_out():
    stamps = np.array([SECOND, SECOND + 100, 3 * SECOND], dtype=np.int64)
    truth = Trajectory(stamps, np.zeros((3, 3)))
    estimates = [estimate(t, 1.0, 0.0, 0.0) for t in (SECOND - 1, SECOND, SECOND + 50, 2 * SECOND, 3 * SECOND + 1)]
    assert len(errors_of(estimates, truth).error) == 2
    with pytest.raises(DiffbotError, match="no estimate at a time with a true pose"):
        errors_of(estimates[3:], truth)


def innovations(rng, count, c, source=("Fix", ())):
    S = np.array([[2.0, 0.6], [0.6, 0.5]])
    factor = np.linalg.cholesky(S)
    white = rng.normal(size=2)
    found = []
    for index in range(count):
        white = c * white + math.sqrt(1.0 - c * c) * rng.normal(size=2)
        y = factor @ white
        found.append(Innovation(index, source, y, S, float(y @ np.linalg.inv(S) @ y), True))
    return found


@pytest.mark.parametrize("c", [0.0, 0.6])
def test_correlation_is_that_of_the_process(c):
    found = consistency_of(innovations(np.random.default_rng(1), 5000, c))
    assert found.correlation == pytest.approx(c, abs=0.03)
    assert found.nis == pytest.approx(1.0, abs=0.06)
    assert found.bound == pytest.approx(1.96 / math.sqrt(2 * 4999))


def test_sources_are_paired_each_by_itself_and_rejected_ones_not_at_all():
    rng = np.random.default_rng(2)
    one, other = (innovations(rng, 2000, 0.7, ("LandmarkMeasurement", (x, 0.0))) for x in (0.0, 1.0))
    outlier = one[0]._replace(y=np.array([1e6, 1e6]), nis=1e12, accepted=False)
    mixed = [item for pair in zip(one, other, strict=True) for item in (*pair, outlier)]
    found = consistency_of(mixed)
    assert found.correlation == pytest.approx(0.7, abs=0.04)
    assert (found.accepted, found.rejected) == (4000, 2000)
