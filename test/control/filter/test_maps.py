"""The map of landmarks."""

import pytest

from diffbot_control.filter.landmark_map import LandmarkMap
from diffbot_core.errors import InvalidValueError


def test_landmarks_are_ordered_by_position_whatever_their_numbers():
    found = LandmarkMap((7, -2, 0), (3.0, 2.0, 2.0), (4.0, 6.0, 5.0)).points()
    assert list(found.items()) == [(0, (2.0, 5.0)), (-2, (2.0, 6.0)), (7, (3.0, 4.0))]


@pytest.mark.parametrize(
    ("found", "name"),
    [
        (LandmarkMap((1, 2, 1), (1.0, 2.0, 3.0), (1.0, 2.0, 3.0)), "landmark_ids"),
        (LandmarkMap((1, 2), (1.0,), (1.0, 2.0)), "landmark_x"),
        (LandmarkMap((1, 2), (1.0, 2.0), (1.0, 2.0, 3.0)), "landmark_y"),
        (LandmarkMap((), (1.0,), (1.0,)), "landmark_x"),
    ],
)
def test_lists_that_do_not_belong_together_are_refused(found, name):
    with pytest.raises(InvalidValueError, match=name):
        found.check()
