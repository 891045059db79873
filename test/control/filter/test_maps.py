"""Ranges to walls, against the plant's own geometry and finite differences; the maps of walls and of landmarks."""

import math

import numpy as np
import pytest
from filter_runs import R_FIX, gated_filter, jacobian
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from diffbot_control.filter.gate import IGNORED, REJECTED, GateMemory, RejectionStreak
from diffbot_control.filter.landmark_map import LandmarkMap
from diffbot_control.filter.measurements import States
from diffbot_control.filter.measurements.wall import WallRange
from diffbot_control.filter.wall_map import WallMap
from diffbot_core.errors import InvalidValueError
from diffbot_core.geometry import Pose
from diffbot_sim.model.beams import true_range

NUMBERS = st.floats(-10.0, 10.0)
POSES = st.tuples(NUMBERS, NUMBERS, st.floats(-3.1, 3.1))
WALLS = st.lists(st.tuples(NUMBERS, NUMBERS, NUMBERS, NUMBERS), min_size=1, max_size=6)
ROOM = WallMap(
    (-12.0, 14.0, 14.0, -12.0), (-12.0, -12.0, 14.0, 14.0), (14.0, 14.0, -12.0, -12.0), (-12.0, 14.0, 14.0, -12.0)
)
BEAMS = Pose(0.2, 0.1, 0.0), Pose(0.0, 0.2, math.pi / 2), Pose(-0.1, -0.2, -2.0)


def walls_of(rows):
    return WallMap(*zip(*rows, strict=True)).walls()


def measured(distance, beam, walls):
    return WallRange(0, distance, np.array([[0.03**2]]), beam, walls)


@settings(max_examples=200)
@given(POSES, POSES, WALLS)
def test_the_length_is_that_of_the_plants_geometry_and_its_jacobian_that_of_finite_differences(pose, beam, rows):
    walls, beam = walls_of(rows), Pose(0.1 * beam[0], 0.1 * beam[1], beam[2])
    true = true_range(Pose(*pose), beam, walls)
    one, x = measured(1.0, beam, walls), np.array([*pose, 0.01, -0.02])
    # Near the end of a wall rounding decides what is hit, and far off a step of the differences is large.
    near = [true_range(Pose(*(np.array(pose) + d)), beam, walls) for d in 1e-4 * np.vstack([np.eye(3), -np.eye(3)])]
    assume(max(near, default=0.0) - min(near) < 0.1 if math.isfinite(true) else not np.isfinite(near).any())
    assert math.isfinite(true) or not one.is_defined(x)
    if one.is_defined(x):
        assert one.expected(x, States(5)).item() == pytest.approx(true, abs=1e-9)
        H = jacobian(lambda at: np.array([true_range(Pose(*at), beam, walls)]), x[:3], 1e-7)
        np.testing.assert_allclose(one.jacobian(x, States(5)), np.pad(H, ((0, 0), (0, 2))), atol=1e-3, rtol=1e-3)


def test_without_a_wall_ahead_or_at_a_flat_angle_a_beam_is_not_defined():
    one = measured(1.0, Pose(0.5, 0.0, 0.0), walls_of([(3.0, -1.0, 3.0, 1.0), (5.0, -9.0, 5.0, 9.0)]))
    assert one.is_defined(np.zeros(3))
    assert not one.is_defined(np.array([0.0, 0.0, math.pi])), "away from all walls"
    assert not one.is_defined(np.array([0.0, 5.0, 1.5])), "at a flat angle"


def test_an_obstacle_before_the_wall_is_rejected_for_as_long_as_it_stands_there():
    found = gated_filter("ekf", P=0.01 * R_FIX, relocation_timeout=0.5)
    before = found.memory.belief
    for _ in range(100):
        found.memory = found.memory._replace(gate=GateMemory(RejectionStreak(0, 0.0), 0, 0.0, RejectionStreak(9, 9.0)))
        assert found.take(measured(1.0, BEAMS[0], ROOM.walls())) == REJECTED
    assert found.memory.belief is before
    assert found.memory.gate.others == RejectionStreak(9, 9.0)
    assert found.take(measured(1.0, BEAMS[0], walls_of([(-3.0, -1.0, -3.0, 1.0)]))) == IGNORED


def test_landmarks_are_ordered_by_position_whatever_their_numbers():
    found = LandmarkMap((7, -2, 0), (3.0, 2.0, 2.0), (4.0, 6.0, 5.0)).points()
    assert list(found.items()) == [(0, (2.0, 5.0)), (-2, (2.0, 6.0)), (7, (3.0, 4.0))]


@pytest.mark.parametrize(
    ("found", "name"),
    [
        (WallMap(wall_y2=(1.0,)), "wall_y2"),
        (WallMap((1.0,), (2.0,), (1.0,), (2.0,)), "wall_x1"),
        (WallMap(beam_topics=("range",), beam_x=(0.0,), beam_y=(0.0,)), "beam_yaw"),
        (WallMap(beam_topics=("range", "range")), "beam_topics"),
        (WallMap(beam_topics=("a b",)), "beam_topics"),
        (LandmarkMap((1, 2, 1), (1.0, 2.0, 3.0), (1.0, 2.0, 3.0)), "landmark_ids"),
        (LandmarkMap((1, 2), (1.0,), (1.0, 2.0)), "landmark_x"),
        (LandmarkMap((1, 2), (1.0, 2.0), (1.0, 2.0, 3.0)), "landmark_y"),
        (LandmarkMap((), (1.0,), (1.0,)), "landmark_x"),
    ],
)
def test_lists_that_do_not_belong_together_are_refused(found, name):
    with pytest.raises(InvalidValueError, match=name):
        found.check()
