"""Errors that last, against the exact covariance of a first-order Markov process and against sampled ones."""

import numpy as np
import pytest
from scipy.linalg import solve_toeplitz

from diffbot_control.filter.correlation import NO_STAMPS, inflation_after, inflation_of, with_stamp
from diffbot_control.filter.measurements import (
    FIXES,
    HEADINGS,
    LANDMARKS,
    Heading,
    LandmarkMeasurement,
    PoseFix,
    Source,
)
from diffbot_core.geometry import Point, Pose

SECOND = 10**9
TIMES = {HEADINGS: 3.0, LANDMARKS: 2.0, FIXES: 1.0, "fixes of gps": 4.0}
"""[s]"""


def fix(seconds, sensor=FIXES):
    return PoseFix(round(seconds * SECOND), Pose(1.0, 2.0, 3.0), np.eye(3), Source(sensor))


def heading(seconds):
    return Heading(round(seconds * SECOND), 1.0, np.eye(1))


def landmark(seconds, x=1.0):
    return LandmarkMeasurement(round(seconds * SECOND), 1.0, 0.5, np.eye(2), Point(x, 2.0))


@pytest.mark.parametrize(("dt", "time"), [(0.2, 0.3), (0.5, 2.0), (1.0, 0.1)])
def test_in_the_long_run_the_measurements_tell_as_much_as_independent_ones_with_the_inflated_variance(dt, time):
    # Best linear estimate of a constant from n errors of variance 1: its information is 1' V^-1 1.
    n = 2000
    information = solve_toeplitz(np.exp(-dt / time) ** np.arange(n), np.ones(n)).sum() / n
    assert inflation_after(dt, time) == pytest.approx(1.0 / information, rel=0.02)


def test_each_source_is_compared_with_itself_and_each_landmark_is_a_source():
    stamps = NO_STAMPS
    for one in (fix(0.0), fix(1.0, sensor="fixes of gps"), heading(2.0), landmark(3.0), landmark(4.0, x=5.0)):
        assert inflation_of(stamps, one, TIMES) == 1.0, "the first of its source"
        before = dict(stamps)
        after = with_stamp(stamps, one, TIMES)
        assert dict(stamps) == before, "never changed in place"
        stamps = after
    expected = (
        (fix(6.0), 6.0, 1.0),
        (fix(6.0, sensor="fixes of gps"), 5.0, 4.0),
        (heading(6.0), 4.0, 3.0),
        (landmark(6.0), 3.0, 2.0),
        (landmark(6.0, x=5.0), 2.0, 2.0),
    )
    for one, dt, time in expected:
        assert inflation_of(stamps, one, TIMES) == pytest.approx(inflation_after(dt, time))
