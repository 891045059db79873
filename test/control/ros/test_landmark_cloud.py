"""Landmarks in point clouds: layouts, invalid clouds, and the covariance of the measurements."""

import math
from types import SimpleNamespace

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given

from diffbot_control.ros.messages.landmark_cloud import LandmarkPoint, fill_landmark_points, landmark_points
from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_control.ros.sensors import KnownNoise, LandmarkSensor
from diffbot_core.errors import BadMessageError
from diffbot_core.schema import build

NUMBERS = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}


def cloud(rows, kinds=(("x", "f4"), ("y", "f4"), ("id", "i4")), big=False, gap=0):
    """Return a cloud with the layout of a numpy array."""
    order = ">" if big else "<"
    parts = [
        part for name, kind in kinds for part in ((f"_{name}", f"V{gap}"), (name, order + kind)) if part[1] != "V0"
    ]
    dtype = np.dtype(parts)
    data = np.zeros(len(rows), dtype)
    for (name, _), column in zip(kinds, zip(*rows, strict=True) if rows else [[]] * len(kinds), strict=True):
        data[name] = column
    fields = [
        SimpleNamespace(name=name, offset=dtype.fields[name][1], datatype=NUMBERS[kind], count=1)
        for name, kind in kinds
    ]
    return SimpleNamespace(
        width=len(rows),
        height=1,
        point_step=dtype.itemsize,
        row_step=data.nbytes,
        fields=fields,
        is_bigendian=big,
        data=data.tobytes(),
    )


@given(st.booleans(), st.integers(0, 9), st.sampled_from([*NUMBERS][:6]), st.sampled_from(["f4", "f8"]))
def test_clouds_of_any_layout_are_read(big, gap, kind, number):
    message = cloud([(4.0, 7, 3.0), (0.0, 120, -1.0)], (("y", number), ("id", kind), ("x", number)), big, gap)
    one, two = landmark_points(message)
    assert (one.number, two.number) == (7, 120)
    assert one[1:3] == pytest.approx((5.0, math.atan2(4.0, 3.0)))
    assert two[1:3] == pytest.approx((1.0, math.pi))
    assert one[3:] == two[3:] == (0.0, 0.0)


def changed(message, **fields):
    for name, value in fields.items():
        setattr(message, name, value)
    return message


ROW = [(2.0, 1.0, 5)]


@pytest.mark.parametrize(
    ("message", "kind"),
    [
        (cloud([(math.nan, 1.0, 5)]), "point not finite"),
        (cloud([(1e8, 1.0, 5)]), "range out of range"),
        (cloud([(0.0, 0.0, 5)]), "range not positive"),
        (cloud([(1.0, 0.0, 5), (2.0, 0.0, 5)]), "landmark twice in a cloud"),
        (cloud([(1.0, 0.0, number) for number in range(101)]), "too many points"),
        (changed(cloud(ROW), data=b""), "cloud sizes contradict each other"),
        (changed(cloud(ROW), row_step=99), "cloud sizes contradict each other"),
        (changed(cloud(ROW), point_step=4), "point fields contradict point_step"),
        (changed(cloud([]), point_step=2**32 - 1, width=0, height=2**32 - 1), "point_step too large"),
        (cloud(ROW, (("x", "i4"), ("y", "f4"), ("id", "i4"))), "point fields missing"),
        (cloud(ROW, (("x", "f4"), ("y", "f4"), ("id", "f4"))), "point fields missing"),
    ],
)
def test_invalid_clouds_are_refused_with_the_reason(message, kind):
    with pytest.raises(BadMessageError) as caught:
        landmark_points(message)
    assert caught.value.kind == kind


def test_a_written_cloud_is_read_and_has_the_layout_that_rviz_requires():
    message = SimpleNamespace()
    points = [LandmarkPoint(3, 2.5, 0.7, 0.01, 0.002), LandmarkPoint(-9, 14.0, -3.0, 0.04, 1e-4)]
    fill_landmark_points(message, points, SimpleNamespace)
    for found, sent in zip(landmark_points(message), points, strict=True):
        assert found.number == sent.number
        assert found[1:] == pytest.approx(sent[1:], rel=1e-6)
    assert [(one.name, one.datatype) for one in message.fields[:3]] == [("x", 7), ("y", 7), ("z", 7)]


CONFIG = build(EkfNodeConfig, {"landmark_ids": [5], "landmark_x": [1.0], "landmark_y": [2.0]})
KNOWN = KnownNoise(np.diag([0.03**2, 0.02**2]), False)


def measured(var_range, var_bearing, noise=KNOWN, x=3.0, y=4.0):
    message = SimpleNamespace(header=SimpleNamespace(frame_id="base_link", stamp=SimpleNamespace(sec=1, nanosec=0)))
    point = LandmarkPoint(5, math.hypot(x, y), math.atan2(y, x), var_range, var_bearing)
    fill_landmark_points(message, [point], SimpleNamespace)
    (found,) = LandmarkSensor(noise, "base_link", CONFIG).read(message).measurements
    return found


def about(*expected):
    """Return a diagonal matrix to compare with; clouds contain variances in single precision."""
    return pytest.approx(np.diag(expected), rel=1e-6)


def test_the_parameters_replace_unknown_or_all_variances():
    assert about(0.03**2, 0.02**2) == measured(0.0, 0.0).R
    assert about(0.03**2, 0.02**2) == measured(0.01, 0.002, KNOWN._replace(always=True)).R
    assert about(0.01, 0.002) == measured(0.01, 0.002).R


@pytest.mark.parametrize("mark", [math.nan, math.inf])
def test_a_variance_that_is_not_finite_means_that_the_number_was_not_measured(mark):
    range_only, bearing_only = measured(0.01, mark), measured(mark, 0.002)
    assert (range_only.z.size, bearing_only.z.size) == (1, 1)
    assert about(0.01) == range_only.R
    assert about(0.002) == bearing_only.R
    assert range_only.z == pytest.approx([5.0])
    assert bearing_only.z == pytest.approx([math.atan2(4.0, 3.0)])
    # The parameters also replace the unknown variance of one number.
    assert about(0.03**2) == measured(0.0, mark).R
    with pytest.raises(BadMessageError, match="covariance is zero"):
        measured(0.0, mark, KnownNoise())
    with pytest.raises(BadMessageError, match="no finite variance"):
        measured(mark, mark)
