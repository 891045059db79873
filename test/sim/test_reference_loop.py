"""Plant, filter and controller together: the reference for the graph."""

import math

import numpy as np
import pytest

from diffbot_control.filter.localization_config import LocalizationConfig
from diffbot_control.law.presets import PRESETS
from diffbot_control.law.regions import OMEGA_L
from diffbot_core.data_sheet import DataSheet
from diffbot_core.errors import InvalidValueError
from diffbot_core.geometry import Pose
from diffbot_sim.feedback import EKF, RAW, TRUTH
from diffbot_sim.model.plant import PlantConfig
from diffbot_sim.model.sensors import SensorConfig
from diffbot_sim.model.simulator import StartPose, WorldConfig
from diffbot_sim.reference_loop import simulate

PAPER = PRESETS["paper"]
GOAL = Pose(0.0, 0.0, 0.0)
INF = math.inf
QUIET = WorldConfig(
    PlantConfig(drive_noise=0.0, encoder_noise=0.0), SensorConfig(eps_x_max=0.0, eps_y_max=0.0, eps_theta_max=0.0)
)


def test_scenario_a_with_the_filter_ends_near_the_goal_in_each_of_five_runs():
    for run in range(5):
        config = WorldConfig(seed=1, run=run)
        recording = simulate(config, PAPER, GOAL, 300)
        x, y, theta = recording.truth[-1]
        assert math.hypot(x, y) < 0.4, f"run {run}"
        assert abs(theta) < 0.05, f"run {run}"
        assert recording.region[-1] == OMEGA_L
        assert np.abs(recording.command[:, 0]).max() <= 1.3
        # The filter is far better than a raw fix of 0.245 m.
        error = np.hypot(*(recording.feedback - recording.truth)[100:, :2].T)
        assert math.sqrt((error**2).mean()) < 0.12, f"run {run}"


@pytest.mark.parametrize("feedback", [EKF, RAW])
def test_it_waits_for_the_first_fix_and_moves_only_then(feedback):
    late = simulate(WorldConfig(sensors=SensorConfig(fix_delay=0.5)), PAPER, GOAL, 20, feedback)
    never = simulate(WorldConfig(sensors=SensorConfig(fix_rate=0.0)), PAPER, GOAL, 20, feedback)
    for recording, first in ((late, 5), (never, 21)):
        assert np.isnan(recording.feedback[:first]).all()
        assert not np.isnan(recording.feedback[first:]).any()
        assert not recording.command[:first].any()
        assert recording.command[first:, 0].all()
        np.testing.assert_array_equal(recording.truth[:first], recording.truth[[0] * first])


@pytest.mark.parametrize("delay", [0.1, 1.0])
def test_late_fixes_are_put_where_they_belong(delay):
    # Exact fixes and noisy wheels at 1.3 m/s: fixes used one step (0.1 s) too late or too early would put the estimate
    # off by 0.13 m all the way; the wheels' noise alone adds up to 0.02 m in 1 s, and to 0.4 m without any fix.
    sensors = QUIET.sensors._replace(fix_delay=delay)
    errors, unaided = [], []
    for run in range(4):
        config = WorldConfig(sensors=sensors, seed=3, run=run, start=StartPose(-12.0, -9.0, 0.6))
        recording = simulate(config, PAPER, GOAL, 100, EKF, LocalizationConfig(history_length=1.2))
        errors.append(np.hypot(*(recording.feedback - recording.truth)[20:, :2].T))
        assert recording.command[20:, 0].min() > 1.2
        alone = simulate(config._replace(sensors=QUIET.sensors._replace(fix_rate=0.02)), PAPER, GOAL, 100)
        unaided.append(np.hypot(*(alone.feedback - alone.truth)[-1, :2]))
    assert np.median(errors) < 0.04
    assert np.max(errors) < 0.1
    assert np.median(unaided) > 0.2


def test_the_first_command_has_no_time_to_accelerate():
    controller = PAPER._replace(data_sheet=DataSheet(1.3, INF, INF, 1.0, INF))
    recording = simulate(QUIET, controller, GOAL, 30, TRUTH)
    assert recording.command[0, 0] == 0.0
    assert np.diff(recording.command[:, 0]).max() <= 0.1 + 1e-12
    assert recording.command[1, 0] == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("steps", "feedback", "message"),
    [(10, "eyes", "feedback = 'eyes': must be one of ekf, raw, truth"), (0, EKF, "steps = 0: must be >= 1")],
)
def test_wrong_arguments_are_named(steps, feedback, message):
    with pytest.raises(InvalidValueError) as caught:
        simulate(QUIET, PAPER, GOAL, steps, feedback)
    assert str(caught.value) == message
