"""Beams of the plant: by hand, and their noise."""

import math

import numpy as np
import pytest

from diffbot_control.filter.wall_map import WallMap
from diffbot_core.geometry import Pose
from diffbot_sim.model.beams import MIN_RANGE, BeamSimulation, measured_range, true_range
from diffbot_sim.model.philox import NoiseKey

WALLS = WallMap((3.0, 5.0), (-1.0, -9.0), (3.0, 5.0), (1.0, 9.0)).walls()


@pytest.mark.parametrize(
    ("pose", "beam", "expected"),
    [
        (Pose(0.0, 0.0, 0.0), Pose(0.0, 0.0, 0.0), 3.0),
        (Pose(0.0, 0.0, 0.5), Pose(0.5, 0.0, -0.5), 3.0 - 0.5 * math.cos(0.5)),
        (Pose(0.0, 1.5, 0.0), Pose(0.0, 0.0, 0.0), 5.0),
        (Pose(4.0, 0.0, math.pi), Pose(0.0, 0.0, 0.0), 1.0),
        (Pose(6.0, 0.0, 0.0), Pose(0.0, 0.0, 0.0), math.inf),
    ],
)
def test_the_true_range_by_hand(pose, beam, expected):
    assert true_range(pose, beam, WALLS) == pytest.approx(expected)


def test_errors_are_uniform_within_their_bound_and_those_of_two_beams_are_independent():
    config = BeamSimulation(beam_error_max=0.2)
    both = np.array(
        [[measured_range(NoiseKey(1, 0, step), index, 4.0, config) for index in (0, 1)] for step in range(4000)]
    )
    assert np.abs(both - 4.0).max() <= 0.2
    np.testing.assert_allclose(both.mean(axis=0), 4.0, atol=0.01)
    np.testing.assert_allclose(both.var(axis=0), config.variance(), rtol=0.1)
    assert config.variance() == pytest.approx(0.2**2 / 3.0)
    assert abs(np.corrcoef(both.T)[0, 1]) < 0.06


def test_there_is_no_echo_from_beyond_the_range_and_none_is_nearer_than_the_least():
    config = BeamSimulation(beam_error_max=0.1, beam_max_range=8.0)
    key = NoiseKey(1, 0, 0)
    assert measured_range(key, 0, 8.01, config) == math.inf
    assert math.isfinite(measured_range(key, 0, 7.99, config))
    assert min(measured_range(NoiseKey(1, 0, step), 0, 0.01, config) for step in range(50)) == MIN_RANGE
