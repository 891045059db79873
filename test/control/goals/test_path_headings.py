"""Paths that get the direction of the path as headings, and paths that keep their headings."""

import math

import numpy as np
import pytest

from diffbot_control.goals.path_headings import directions, with_headings
from diffbot_core.geometry import Pose

STEP = 0.05


def line(angle, heading=0.0, end=None):
    """Return a straight path of 2 m whose poses have one heading, the last one ``end``."""
    path = [Pose(STEP * i * math.cos(angle), STEP * i * math.sin(angle), heading) for i in range(41)]
    return path if end is None else [*path[:-1], path[-1]._replace(theta=end)]


def headings(poses):
    return np.array([one.theta for one in poses])


@pytest.mark.parametrize("angle", [math.pi / 2, math.pi, -0.5])
def test_a_path_with_default_orientations_gets_its_direction_and_keeps_the_last_heading(angle):
    path = line(angle, end=1.0)
    followed = with_headings(path, are_default=True)
    assert np.allclose(headings(followed)[:-1], angle)
    assert followed[-1] == path[-1]
    assert [(one.x, one.y) for one in followed] == [(one.x, one.y) for one in path]


@pytest.mark.parametrize(
    ("path", "are_default", "direction"),
    [
        (line(-1.2, heading=0.7), False, -1.2),
        (line(math.pi), True, math.pi),
        (line(0.5 + math.pi, heading=0.5, end=2.0), False, 0.5 - math.pi),
    ],
    ids=["from a turned frame", "backwards, empty orientations", "backwards, with another heading at the end"],
)
def test_equal_headings_that_contradict_the_direction_are_replaced(path, are_default, direction):
    found = headings(with_headings(path, are_default))[:-1]
    assert np.allclose(np.cos(found - direction), 1.0)


def test_the_first_pose_may_have_the_heading_of_the_robot():
    path = [Pose(0.0, 0.0, -2.0), *line(math.pi / 2)[1:]]
    assert headings(with_headings(path, are_default=True))[:2] == pytest.approx([-2.0, math.pi / 2])


@pytest.mark.parametrize(
    "path",
    [
        line(0.1),
        [one._replace(theta=math.pi / 2 + 0.01 * i) for i, one in enumerate(line(math.pi / 2))],
        line(0.5 + math.pi, heading=0.5),
        [Pose(1.0, 0.0, 2.0), Pose(0.0, 1.0, 1.0)],
        [Pose(0.0, 0.0, 0.0)],
        [Pose(1.0, 2.0, 3.0)] * 5,
    ],
    ids=["nearly along", "own headings", "backwards", "two goals", "one goal", "without length"],
)
def test_other_paths_do_not_change(path):
    assert with_headings(path, are_default=False) is path


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
