"""Which paths get the direction of the path as headings."""

import math

import numpy as np
import pytest

from diffbot_control.goals.path import directions, with_headings
from diffbot_core.geometry import Pose

STEP = 0.05


def line(angle, length=2.0, heading=0.0):
    count = round(length / STEP) + 1
    return [Pose(i * STEP * math.cos(angle), i * STEP * math.sin(angle), heading) for i in range(count)]


def headings(poses):
    return np.array([one.theta for one in poses])


@pytest.mark.parametrize("angle", [math.pi / 2, math.pi, -0.5])
def test_a_path_with_default_orientations_gets_its_direction_and_keeps_the_last_heading(angle):
    path = line(angle)
    path[-1] = path[-1]._replace(theta=1.0)
    followed = with_headings(path, are_default=True)
    assert np.allclose(headings(followed)[:-1], angle)
    assert followed[-1] == path[-1]
    assert [(one.x, one.y) for one in followed] == [(one.x, one.y) for one in path]


def test_equal_orientations_that_are_not_the_default_are_replaced_too():
    # As after the transformation from a frame that is turned.
    assert np.allclose(headings(with_headings(line(-1.2, heading=0.7), are_default=False))[:-1], -1.2)


def test_the_first_pose_may_have_the_heading_of_the_robot():
    path = [Pose(0.0, 0.0, -2.0), *line(math.pi / 2)[1:]]
    assert headings(with_headings(path, are_default=True))[:2] == pytest.approx([-2.0, math.pi / 2])


@pytest.mark.parametrize(
    "path",
    [
        line(0.0),
        line(0.1),
        [one._replace(theta=math.pi / 2 + 0.01 * i) for i, one in enumerate(line(math.pi / 2))],
        line(0.5 + math.pi, heading=0.5),
        [Pose(1.0, 0.0, 2.0), Pose(0.0, 1.0, 1.0)],
        [Pose(0.0, 0.0, 0.0)],
        [Pose(1.0, 2.0, 3.0)] * 5,
    ],
    ids=["along", "nearly along", "headings of their own", "backwards", "two goals", "one goal", "without length"],
)
def test_other_paths_stay_as_they_are(path):
    assert with_headings(path, are_default=False) is path


def test_a_path_backwards_of_empty_orientations_is_followed_forwards():
    assert np.allclose(np.abs(headings(with_headings(line(math.pi), are_default=True))[:-1]), math.pi)


def test_a_path_backwards_that_ends_with_another_heading_is_followed_forwards():
    path = line(0.5 + math.pi, heading=0.5)
    path[-1] = path[-1]._replace(theta=2.0)
    assert np.allclose(headings(with_headings(path, are_default=False))[:-1], 0.5 - math.pi)


def test_few_waypoints_bisect_their_corners():
    square = [Pose(0.0, 0.0, 0.0), Pose(2.0, 0.0, 0.0), Pose(2.0, 2.0, 0.0), Pose(0.0, 2.0, 0.0)]
    assert headings(with_headings(square, are_default=True)) == pytest.approx([0.0, np.pi / 4, 3 * np.pi / 4, 0.0])


def test_directions_bridge_repeated_poses_and_steps_of_a_grid_and_turn_with_the_path():
    assert np.allclose(directions([one for one in line(1.0) for _ in range(3)]), 1.0)
    grid = [Pose(STEP * i, STEP * ((i // 2) % 2), 0.0) for i in range(41)]
    assert np.abs(directions(grid)).max() < 0.45
    circle = [Pose(math.sin(a), 1.0 - math.cos(a), 0.0) for a in np.arange(0.0, 4.0, STEP)]
    assert np.allclose(np.unwrap(directions(circle))[5:-5], np.arange(0.0, 4.0, STEP)[5:-5], atol=0.03)
    there_and_back = [Pose(0.0, 0.0, 0.0), Pose(1.0, 0.0, 0.0), Pose(0.0, 0.0, 0.0)]
    assert np.allclose(np.abs(directions(there_and_back)), [0.0, math.pi, math.pi])
