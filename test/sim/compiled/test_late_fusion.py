"""Late measurements in the compiled loop: the poses of the node's own fusion, fix by fix, in all variants."""

import math

import numpy as np
import pytest

from diffbot_control.filter.landmark_map import LandmarkMap
from diffbot_control.filter.localization_config import LocalizationConfig
from diffbot_control.filter.options import FILTERS, FilterConfig, options_of
from diffbot_control.law.presets import PRESETS
from diffbot_core.geometry import Pose
from diffbot_sim.compiled.batch import FEEDBACK_CODES, Starts, run_batch, run_histories
from diffbot_sim.compiled.closed_loop import Case, prepared, run_loop
from diffbot_sim.compiled.late_fusion import late_steps
from diffbot_sim.model.plant import PlantConfig
from diffbot_sim.model.sensors import SensorConfig
from diffbot_sim.model.simulator import StartPose, WorldConfig
from diffbot_sim.reference_loop import simulate

PLANT, CONTROLLER, GOAL = PlantConfig(), PRESETS["paper"], Pose(0.0, 0.0, 0.0)
START = (-2.0, -5.5, math.radians(30.0))
# In the order of their positions, in which the node fuses those of one stamp.
LANDMARKS = LandmarkMap((1, 2, 3), (-3.0, 0.5, 3.0), (2.0, -3.0, 1.0))
CONSTANT = SensorConfig(fix_rate=5.0, fix_delay=0.15)
SENSORS = {
    "constant": CONSTANT,
    "outliers, headings later than fixes": SensorConfig(
        fix_rate=5.0,
        fix_delay=0.32,
        fix_delay_jitter=0.5,
        fix_dropout=0.2,
        fix_outlier=0.1,
        heading_rate=10.0,
        heading_delay=0.5,
    ),
    # The heading of the first fix's stamp comes after the first odometry step, at the start of the history.
    "first heading after the first fix": SensorConfig(fix_delay=0.2, heading_rate=5.0, heading_delay=0.3),
    "first heading with the first fix": SensorConfig(fix_delay=0.2, heading_rate=5.0, heading_delay=0.2),
    "headings only are late": SensorConfig(heading_rate=5.0, heading_delay=0.3),
    "landmarks in time": SensorConfig(fix_delay_jitter=0.6, landmark_rate=5.0, heading_rate=10.0, heading_delay=0.1),
    "the whole history": SensorConfig(fix_rate=5.0, fix_delay=0.6, fix_delay_jitter=0.4),
}
pytestmark = pytest.mark.timeout(600)
"""The first run compiles: on a busy machine for minutes."""


def case_of(sensors, feedback="ekf", variant="ekf_calibrating", plant=PLANT, steps=120):
    points = np.array(list(LANDMARKS.points().values()))
    options = options_of(FilterConfig(filter=variant))
    code = FEEDBACK_CODES[feedback]
    return Case(plant, sensors, CONTROLLER, GOAL, code, False, steps, 0.4, 0.1, filter=options, landmarks=points)


def expected_of(sensors, seed, run, feedback="ekf", variant="ekf_calibrating", plant=PLANT, steps=120):
    world = WorldConfig(plant, sensors, StartPose(*START), seed, run, LANDMARKS)
    localization = LocalizationConfig(1.0, FilterConfig(filter=variant))
    found = simulate(world, CONTROLLER, GOAL, steps, feedback, localization)
    return np.column_stack([found.truth, found.feedback, found.command, found.sigma])


def assert_same(history, expected):
    np.testing.assert_array_equal(np.isnan(history), np.isnan(expected))
    difference = history - expected
    difference[:, [2, 5]] = np.remainder(difference[:, [2, 5]] + math.pi, 2.0 * math.pi) - math.pi
    assert np.nanmax(np.abs(difference)) < 1e-9


@pytest.mark.parametrize("name", SENSORS)
def test_late_measurements_are_fused_as_the_node_fuses_them(name):
    sensors = SENSORS[name]
    case = prepared(case_of(sensors))
    for seed, run in ((1, 0), (2**40 + 3, 5)):
        history = np.empty((case.steps + 1, 9))
        run_loop(case, seed, run, Pose(*START), history)
        assert_same(history, expected_of(sensors, seed, run))


@pytest.mark.parametrize("variant", FILTERS)
def test_compiled_is_the_same(variant):
    sensors = SENSORS["outliers, headings later than fixes"]
    histories = run_histories(case_of(sensors, variant=variant), Starts(np.array([START])), 9, 0, 2)
    for run, history in enumerate(histories):
        assert_same(history, expected_of(sensors, 9, run, variant=variant))


def test_the_newest_fix_is_the_one_that_arrived_last():
    sensors = SensorConfig(fix_delay=0.1, fix_delay_jitter=0.45)
    case = case_of(sensors, "raw")
    history = run_histories(case, Starts(np.array([START])), 2, 7, 1)[0]
    assert_same(history, expected_of(sensors, 2, 7, "raw"))
    assert np.isnan(history[:2, 3]).all()


def test_a_late_fix_corrects_the_pose_of_its_own_time():
    # Exact fixes, half a second late, and noisy wheels: who took them for the present pose would be 0.3 m behind.
    exact = SensorConfig(fix_delay=0.5, eps_x_max=0.0, eps_y_max=0.0, eps_theta_max=0.0)
    history = run_histories(case_of(exact), Starts(np.array([START])), 3, 0, 20)[:, 20:]
    errors = np.hypot(history[:, :, 3] - history[:, :, 0], history[:, :, 4] - history[:, :, 1])
    assert errors.max() < 0.05


def test_the_ring_is_long_enough_for_other_sampling_times():
    for t_s, sensors in ((0.04, CONSTANT._replace(fix_delay_jitter=0.3)), (0.25, CONSTANT._replace(fix_delay=0.9))):
        plant = PLANT._replace(sampling_time=t_s)
        history = np.empty((121, 9))
        run_loop(prepared(case_of(sensors, plant=plant)), 4, 1, Pose(*START), history)
        assert_same(history, expected_of(sensors, 4, 1, plant=plant))


@pytest.mark.parametrize(
    ("sensors", "steps"),
    [
        (SensorConfig(), None),
        (SensorConfig(fix_delay=0.1), 1),
        (SensorConfig(fix_delay=0.15, fix_delay_jitter=0.1), 3),
        (SensorConfig(heading_delay=0.3, fix_delay_jitter=0.01), 3),
    ],
)
def test_the_longest_delay(sensors, steps):
    assert late_steps(sensors, 0.1) == steps
    assert prepared(case_of(sensors)).late_steps == steps
    assert prepared(case_of(sensors, "truth")).late_steps is None


def test_the_bound_of_the_delay_is_the_cases():
    case = case_of(CONSTANT._replace(fix_delay=1.4))._replace(history_length=2.0)
    assert np.isfinite(run_batch(case, Starts(np.array([START])), 1, 0, 2)[:, 0]).all()
