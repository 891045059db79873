"""The map of landmarks, and how a point is seen."""

import cmath
import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from diffbot_control.config import build
from diffbot_control.errors import InvalidValueError
from diffbot_control.landmarks import LandmarkMap, seen_from

CHECK = settings(derandomize=True, deadline=None, max_examples=200)
PLACES = st.floats(-100.0, 100.0)


def test_the_map_by_its_numbers():
    found = LandmarkMap((7, -2, 0), (1.0, 2.0, 3.0), (4.0, 5.0, 6.0))
    found.check()
    assert found.points() == {7: (1.0, 4.0), -2: (2.0, 5.0), 0: (3.0, 6.0)}
    assert list(found.points()) == [7, -2, 0]
    assert LandmarkMap().points() == {}


@pytest.mark.parametrize(
    ("ids", "x", "y", "name"),
    [
        ((1, 2, 1), (1.0, 2.0, 3.0), (1.0, 2.0, 3.0), "landmark_ids"),
        ((1, 2), (1.0,), (1.0, 2.0), "landmark_x"),
        ((1, 2), (1.0, 2.0), (1.0, 2.0, 3.0), "landmark_y"),
        ((), (1.0,), (1.0,), "landmark_x"),
        ((1,), (), (), "landmark_x"),
    ],
)
def test_lists_that_do_not_belong_together_are_refused(ids, x, y, name):
    with pytest.raises(InvalidValueError, match=name):
        LandmarkMap(ids, x, y).check()
    with pytest.raises(InvalidValueError, match=name):
        build(LandmarkMap, {"landmark_ids": ids, "landmark_x": x, "landmark_y": y})


@pytest.mark.parametrize("value", [math.nan, math.inf, 1.1e7, -1.1e7])
def test_a_landmark_that_is_nowhere_is_refused(value):
    with pytest.raises(InvalidValueError, match="landmark_x"):
        build(LandmarkMap, {"landmark_ids": (1,), "landmark_x": (value,), "landmark_y": (0.0,)})


def test_seen_by_hand():
    # A triangle of 3, 4, 5 from (1, 1), looking along +y.
    distance, bearing = seen_from(1.0, 1.0, 0.5 * math.pi, 4.0, 5.0)
    assert distance == pytest.approx(5.0)
    assert bearing == pytest.approx(-math.atan2(3.0, 4.0))
    assert seen_from(2.0, 3.0, 0.0, 2.0, 5.0) == pytest.approx((2.0, 0.5 * math.pi))
    assert seen_from(2.0, 3.0, 0.5, 2.0, 3.0)[0] == 0.0


@CHECK
@given(PLACES, PLACES, st.floats(-3.1, 3.1), PLACES, PLACES)
def test_going_there_as_seen_one_arrives(x, y, theta, point_x, point_y):
    distance, bearing = seen_from(x, y, theta, point_x, point_y)
    arrived = complex(x, y) + cmath.rect(distance, theta + bearing)
    assert abs(arrived - complex(point_x, point_y)) < 1e-9
