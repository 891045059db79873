"""Covariance of a landmark measurement: of the message, or of the parameters at its range; of one number."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from diffbot_control.ros.sensor_messages import KnownNoise, landmarks_from
from diffbot_core.errors import BadMessageError
from diffbot_core.geometry import Point

LAYOUT = np.dtype([("x", "<f8"), ("y", "<f8"), ("id", "<i4"), ("range_variance", "<f8"), ("bearing_variance", "<f8")])
POINTS = {5: Point(1.0, 2.0)}
KNOWN = KnownNoise(np.diag([0.03**2, 0.02**2]), False, 0.025)


def measured(var_range, var_bearing, noise=KNOWN, x=3.0, y=4.0):
    data = np.array([(x, y, 5, var_range, var_bearing)], LAYOUT)
    types = {"x": 8, "y": 8, "id": 5, "range_variance": 8, "bearing_variance": 8}
    fields = [
        SimpleNamespace(name=name, offset=LAYOUT.fields[name][1], datatype=kind, count=1)
        for name, kind in types.items()
    ]
    message = SimpleNamespace(
        header=SimpleNamespace(frame_id="base_link", stamp=SimpleNamespace(sec=1, nanosec=0)),
        width=1,
        height=1,
        point_step=LAYOUT.itemsize,
        row_step=LAYOUT.itemsize,
        fields=fields,
        is_bigendian=False,
        data=data.tobytes(),
    )
    found, _ = landmarks_from(message, "base_link", POINTS, noise)
    return found[0]


@pytest.mark.parametrize(("x", "y", "sigma"), [(3.0, 4.0, 0.155), (0.6, -0.8, 0.055), (0.0, 10.0, 0.28)])
def test_the_deviation_of_a_range_grows_with_it(x, y, sigma):
    R = measured(0.0, 0.0, x=x, y=y).R
    np.testing.assert_allclose(R, np.diag([sigma**2, 0.02**2]), rtol=1e-12)


def test_the_variances_of_the_message_do_not_grow():
    np.testing.assert_allclose(measured(0.01, 0.002).R, np.diag([0.01, 0.002]))
    np.testing.assert_allclose(measured(0.01, 0.002, KNOWN._replace(always=True)).R, np.diag([0.155**2, 0.02**2]))


@pytest.mark.parametrize("mark", [math.nan, math.inf])
def test_a_variance_that_is_not_finite_marks_a_missing_number(mark):
    range_only, bearing_only = measured(0.01, mark), measured(mark, 0.002)
    assert (range_only.numbers, bearing_only.numbers) == (1, 1)
    assert range_only.R.tolist() == [[0.01, 0.0], [0.0, math.inf]]
    assert bearing_only.R.tolist() == [[math.inf, 0.0], [0.0, 0.002]]
    assert range_only.range == pytest.approx(5.0)
    assert bearing_only.bearing == pytest.approx(math.atan2(4.0, 3.0))


def test_the_parameters_give_the_noise_of_one_number_too():
    always = KNOWN._replace(always=True)
    assert measured(0.0, math.nan).R.tolist() == [[pytest.approx(0.155**2), 0.0], [0.0, math.inf]]
    assert measured(math.nan, 0.5, always).R.tolist() == [[math.inf, 0.0], [0.0, pytest.approx(0.02**2)]]
    with pytest.raises(BadMessageError, match="covariance is zero"):
        measured(0.0, math.nan, KnownNoise())


def test_a_point_without_any_number_is_refused():
    with pytest.raises(BadMessageError, match="no finite variance"):
        measured(math.nan, math.inf)
