"""Covariance of a landmark measurement: of the message, or of the parameters at its range; of one number."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from diffbot_control.ros.messages.landmark_cloud import LandmarkPoint, fill_landmark_points
from diffbot_control.ros.sensors.landmarks import landmarks_from
from diffbot_control.ros.sensors.noise import KnownNoise
from diffbot_core.errors import BadMessageError
from diffbot_core.geometry import Point

POINTS = {5: Point(1.0, 2.0)}
KNOWN = KnownNoise(np.diag([0.03**2, 0.02**2]), False)


def measured(var_range, var_bearing, noise=KNOWN, x=3.0, y=4.0):
    message = SimpleNamespace(header=SimpleNamespace(frame_id="base_link", stamp=SimpleNamespace(sec=1, nanosec=0)))
    point = LandmarkPoint(5, math.hypot(x, y), math.atan2(y, x), var_range, var_bearing)
    fill_landmark_points(message, [point], SimpleNamespace)
    return landmarks_from(message, "base_link", POINTS, noise, 0.025)[0][0]


def about(*expected):
    """Return a diagonal for a comparison: the variances come in single precision."""
    return pytest.approx(np.diag(expected), rel=1e-6)


@pytest.mark.parametrize(("x", "y", "sigma"), [(3.0, 4.0, 0.155), (0.6, -0.8, 0.055), (0.0, 10.0, 0.28)])
def test_the_deviation_of_the_parameters_grows_with_the_range_and_that_of_the_message_does_not(x, y, sigma):
    always = KNOWN._replace(always=True)
    assert about(sigma**2, 0.02**2) == measured(0.0, 0.0, x=x, y=y).R
    assert about(sigma**2, 0.02**2) == measured(0.01, 0.002, always, x, y).R
    assert about(0.01, 0.002) == measured(0.01, 0.002, x=x, y=y).R


@pytest.mark.parametrize("mark", [math.nan, math.inf])
def test_a_variance_that_is_not_finite_marks_a_missing_number(mark):
    range_only, bearing_only = measured(0.01, mark), measured(mark, 0.002)
    assert (range_only.z.size, bearing_only.z.size) == (1, 1)
    assert about(0.01, math.inf) == range_only.R
    assert about(math.inf, 0.002) == bearing_only.R
    assert range_only.range == pytest.approx(5.0)
    assert bearing_only.bearing == pytest.approx(math.atan2(4.0, 3.0))
    # The parameters give the noise of one number, too.
    assert about(0.155**2, math.inf) == measured(0.0, mark).R
    with pytest.raises(BadMessageError, match="covariance is zero"):
        measured(0.0, mark, KnownNoise())
    with pytest.raises(BadMessageError, match="no finite variance"):
        measured(mark, mark)
