"""Plant, filter and controller together: the reference for the graph."""

import numpy as np
import pytest

from diffbot_control.law.presets import PRESETS
from diffbot_core.errors import InvalidValueError
from diffbot_core.geometry import Pose
from diffbot_sim.config import PlantConfig, SensorConfig, WorldConfig
from diffbot_sim.robot_step import EKF, RAW
from diffbot_sim.simulation import simulate

LAW, PAPER = PRESETS["paper"]
GOAL = Pose(0.0, 0.0, 0.0)
QUIET = WorldConfig(PlantConfig(drive_noise=0.0, encoder_noise=0.0), SensorConfig(eps_xy_max=0.0, eps_theta_max=0.0))


@pytest.mark.parametrize("feedback", [EKF, RAW])
def test_it_waits_for_the_first_fix_and_moves_only_then(feedback):
    late = simulate(WorldConfig(sensors=SensorConfig(fix_delay=0.5)), PAPER, GOAL, 20, feedback, law=LAW)
    never = simulate(WorldConfig(sensors=SensorConfig(fix_rate=0.0)), PAPER, GOAL, 20, feedback, law=LAW)
    for recording, first in ((late, 5), (never, 21)):
        assert np.isnan(recording.feedback[:first]).all()
        assert not np.isnan(recording.feedback[first:]).any()
        assert not recording.command[:first].any()
        assert recording.command[first:, 0].all()
        np.testing.assert_array_equal(recording.truth[:first], recording.truth[[0] * first])


@pytest.mark.parametrize(
    ("steps", "feedback", "message"),
    [(10, "eyes", "feedback = 'eyes': must be one of truth, raw, ekf"), (0, EKF, "steps = 0: must be >= 1")],
)
def test_wrong_arguments_are_named(steps, feedback, message):
    with pytest.raises(InvalidValueError) as caught:
        simulate(QUIET, PAPER, GOAL, steps, feedback, law=LAW)
    assert str(caught.value) == message
