"""The compiled closed loop equals the plain one and the nodes' filter, for any chunks and threads."""

import math

import numpy as np
import pytest

from diffbot_control.filter.config import FilterConfig, LandmarkMap, LocalizationConfig, options_of
from diffbot_control.goals import SupervisorConfig
from diffbot_control.law.configuration import PaperConfig, PaperGains, SwitchingConfig
from diffbot_control.law.law import CONTACT_UNKNOWN, Observation
from diffbot_control.law.paper import PaperLaw
from diffbot_control.law.switching import SwitchingLaw, new_memory, step
from diffbot_core.data_sheet import DataSheet
from diffbot_core.errors import InvalidValueError
from diffbot_core.geometry import Pose, into_frame
from diffbot_core.uncertainty import Estimate
from diffbot_sim import batch
from diffbot_sim.batch import COLUMNS, Starts, run_batch, run_histories
from diffbot_sim.config import DetectorConfig, PlantConfig, SensorConfig, StartPose, WorldConfig
from diffbot_sim.fusion import SimulatedRobot
from diffbot_sim.robot_step import FEEDBACKS, Case
from diffbot_sim.simulation import ClosedLoop, simulate

ORIGIN = Pose(0.0, 0.0, 0.0)
PAPER = PlantConfig(exact_arc=False, drive_noise=0.0, encoder_noise=0.0, eps_v_max=0.065, eps_omega_max=0.2167)
QUIET = PlantConfig(drive_noise=0.0, encoder_noise=0.0)
NOISY, SENSORS, CONTROLLER = PlantConfig(), SensorConfig(), SwitchingConfig()
EXACT = SensorConfig(eps_xy_max=0.0, eps_theta_max=0.0)
LIMITED = CONTROLLER._replace(data_sheet=DataSheet(1.0, 1.5, 15.0, 0.8, 2.0))
FASTER = PaperConfig(gains=PaperGains(1.1, 2.5, 0.6, 1.9), eps_P=0.25, eps_P_leave=0.3)
START = (-2.0, -5.5, math.radians(30.0))
TOO_LATE = "must be <= 1 s, the length of the filter's history"
LATE_DETECTOR = SensorConfig(fix_rate=0.0, detector=DetectorConfig(detection_rate=5.0, detection_delay=1.1))


def case_of(plant=PAPER, sensors=SENSORS, controller=CONTROLLER, goal=ORIGIN, feedback="raw", steps=150):
    robot = SimulatedRobot(plant, sensors, options_of(LocalizationConfig()), np.empty((0, 2)))
    return Case(robot, controller, goal, FEEDBACKS.index(feedback), False, steps, 0.4, 0.1)


def with_filter(case, config, landmarks=()):
    options, places = options_of(LocalizationConfig(filter=config), landmarks=landmarks), np.array(landmarks)
    return case._replace(robot=case.robot._replace(filter=options, landmarks=places.reshape(-1, 2)))


def law_of(case):
    return PaperLaw if isinstance(case.controller, PaperConfig) else SwitchingLaw


def outcome_of(case, start, seed=1, run=0):
    found = run_batch(case, Starts(np.array([start])), seed, run, 1, law=law_of(case))
    return dict(zip(COLUMNS, found[0], strict=True))


def wrapped(angles):
    return np.remainder(np.asarray(angles) + math.pi, 2.0 * math.pi) - math.pi


def assert_same_poses(actual, expected, tolerance):
    np.testing.assert_array_equal(np.isnan(actual), np.isnan(expected))
    known = ~np.isnan(expected).any(axis=1)
    np.testing.assert_allclose(actual[known, :2], expected[known, :2], rtol=0.0, atol=tolerance)
    np.testing.assert_allclose(wrapped(actual[known, 2] - expected[known, 2]), 0.0, atol=tolerance)


WORLDS = {
    "3 Hz, dropouts, outliers, headings": (
        PlantConfig(
            left_radius_error=0.04, right_radius_error=-0.03, slip_right=0.6, slip_start=1.1, slip_duration=3.2
        ),
        SensorConfig(fix_rate=3.0, fix_dropout=0.4, fix_outlier=0.2, heading_rate=10.0, heading_error_max=0.05),
        FASTER,
        ORIGIN,
        START,
    ),
    "paper's noise, limits": (PAPER._replace(wheel_speed_max=18.0), SensorConfig(), LIMITED, ORIGIN, (3.0, -4.0, 1.0)),
    "actuators, another goal and sampling time": (
        PlantConfig(
            **{"sampling_time": 0.05, "command_delay": 0.23, "drive_time_constant": 0.2, "acceleration_max": 0.5},
            **{"angular_acceleration_max": 1.5, "wheel_speed_max": 20.0, "dead_band": 0.4},
            **{"slip_noise": 0.05, "separation_error": 0.03},
        ),
        SensorConfig(fix_noise_correlation=0.9, fix_dropout=0.1),
        FASTER,
        Pose(4.0, -3.0, 2.5),
        (9.0, 2.0, -2.9),
    ),
}
# In the order of their positions, in which the node fuses measurements of one stamp.
LANDMARKS = LandmarkMap((1, 2, 3), (-3.0, 0.5, 3.0), (2.0, -3.0, 1.0))
POINTS = tuple(LANDMARKS.points().values())
FAULTS = SensorConfig(fix_rate=5.0, fix_delay=0.32, fix_dropout=0.2, fix_outlier=0.1, heading_rate=10.0)
GYRO = SensorConfig(fix_rate=2.0, gyro_rate=10.0, gyro_bias=0.05, landmark_rate=2.0)
SLIPPING = PlantConfig(encoder_noise=0.01, slip_right=0.1, slip_start=4.0, slip_duration=8.0)
"""Enough slip that the gyro contradicts the wheels and the filter distrusts their radii."""
KIDNAPPED = PlantConfig(kidnap_time=4.0, kidnap_x=4.0, kidnap_yaw=1.0)


def fused(sensors, variant="ekf_calibrating", plant=NOISY, **options):
    return plant, sensors, FilterConfig(filter=variant, **options)


LATE = {
    "outliers, headings before fixes": fused(FAULTS, "ekf_fnn_calibrating"),
    "landmarks": fused(SensorConfig(fix_delay=0.3, landmark_rate=5.0, heading_rate=10.0), "ekf_fnn"),
    "short steps": fused(SensorConfig(fix_rate=5.0, fix_delay=0.15), plant=PlantConfig(sampling_time=0.04)),
    "long steps": fused(SensorConfig(fix_rate=5.0, fix_delay=0.9), plant=PlantConfig(sampling_time=0.25)),
    "gyro, late fixes": fused(GYRO._replace(gyro_rate=4.0, fix_delay=0.25), plant=SLIPPING, use_gyro=True),
    "kidnapped": fused(
        SensorConfig(fix_rate=5.0, fix_outlier=0.2, heading_rate=5.0, landmark_rate=2.0), "ekf", KIDNAPPED
    ),
    "time-correlated errors": fused(SensorConfig(fix_rate=5.0, fix_noise_correlation=0.9)),
    "no heading": fused(SensorConfig(fix_covariance_scale=4.0, eps_theta_max=3.1, heading_rate=5.0)),
}


def assert_same_histories(history, expected):
    assert_same_poses(history[:, :3], expected.truth, 1e-9)
    assert_same_poses(history[:, 3:6], expected.feedback, 1e-9)
    np.testing.assert_allclose(history[:, 6:8], expected.command, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(history[:, 8], expected.sigma, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("feedback", FEEDBACKS)
@pytest.mark.parametrize("name", WORLDS)
def test_the_compiled_loop_equals_the_plain_loop(name, feedback):
    plant, sensors, controller, goal, start = WORLDS[name]
    case = case_of(plant, sensors, controller, goal, feedback)
    moved = 0.0
    for seed, run in ((2**40 + 3, 5), (2**63 - 1, 2**33 + 1)):
        world = WorldConfig(plant, sensors, StartPose(*start), seed, run)
        expected = simulate(world, controller, goal, case.steps, feedback, law=law_of(case))
        history = run_histories(case, Starts(np.array([start])), seed, run, 1, law=law_of(case))[0]
        assert_same_histories(history, expected)
        assert (np.nanmin(history[:, 8]) > 0.0) == (feedback == "ekf")
        moved += np.hypot(*(expected.truth[-1, :2] - expected.truth[0, :2]))

        outcome = outcome_of(case, start, seed, run)
        local = np.array([into_frame(Pose(*row), goal) for row in expected.truth.tolist()])
        outside = (np.hypot(*local.T[:2]) > case.xy_tolerance) | (np.abs(local[:, 2]) > case.yaw_tolerance)
        last = np.flatnonzero(outside)[-1] if outside.any() else -1
        settled = expected.time[last + 1] - expected.time[0] if last + 1 < len(outside) else math.nan
        assert [outcome["x"], outcome["y"]] == pytest.approx(local[-1, :2], abs=1e-9)
        assert wrapped(outcome["theta"] - local[-1, 2]) == pytest.approx(0.0, abs=1e-9)
        assert outcome["settling_time"] == pytest.approx(settled, abs=1e-9, nan_ok=True)
        assert outcome["path_length"] == pytest.approx(np.hypot(*np.diff(expected.truth.T[:2])).sum(), abs=1e-9)
        assert outcome["effort"] == pytest.approx(
            (expected.command[:-1] ** 2).sum() * plant.sampling_time, rel=1e-9, abs=1e-12
        )
        assert outcome["switches"] == np.count_nonzero(np.diff(expected.region, prepend=0))
        local = np.flatnonzero(expected.region)
        assert outcome["local_time"] == pytest.approx(expected.time[local[0]] if local.size else math.nan, nan_ok=True)
        error = np.hypot(*(expected.feedback[-1] - expected.truth[-1])[:2])
        assert outcome["estimation_error"] == pytest.approx(error, abs=1e-9, nan_ok=True)
    assert moved > 1.0  # the robot has moved


@pytest.mark.parametrize("name", LATE)
def test_measurements_are_fused_as_by_the_filter_of_the_nodes(name):
    plant, sensors, config = LATE[name]
    case = with_filter(case_of(plant, sensors, feedback="ekf", steps=120), config, POINTS)
    world = WorldConfig(plant, sensors, StartPose(*START), 9, 1, LANDMARKS)
    localization = LocalizationConfig(1.0, config)
    plain = simulate(world, CONTROLLER, ORIGIN, 120, "ekf", localization)
    assert_same_histories(run_histories(case, Starts(np.array([START])), 9, 1, 1)[0], plain)
    # The filter of the nodes, with its history of messages.
    node, memory = ClosedLoop(world, localization, SupervisorConfig(), SwitchingLaw), new_memory()
    for index in range(121):
        node.sense()
        np.testing.assert_allclose(node.truth, plain.truth[index], rtol=0.0, atol=1e-9)
        assert (node.estimate is None) == np.isnan(plain.feedback[index, 0])
        command = (0.0, 0.0)
        if node.estimate is not None:
            np.testing.assert_allclose(node.estimate, plain.feedback[index], rtol=0.0, atol=1e-9)
            found, dt = Estimate(node.estimate, node.uncertainty), plant.sampling_time if index else 0.0
            seen = Observation(found, dt, plant.sampling_time, CONTACT_UNKNOWN)
            memory, command, _ = step(memory, seen, ORIGIN, CONTROLLER)
        node.world.advance(type(node.world.state.twist)(*command))


@pytest.mark.parametrize("feedback", ["ekf", "raw"])
def test_the_robot_stands_still_until_the_first_fix(feedback):
    for sensors, first in ((SensorConfig(fix_delay=0.5), 5), (SensorConfig(fix_rate=0.0), 21)):
        recording = simulate(WorldConfig(sensors=sensors), CONTROLLER, ORIGIN, 20, feedback)
        assert np.isnan(recording.feedback[:first]).all()
        assert not np.isnan(recording.feedback[first:]).any()
        assert not recording.command[:first].any()
        assert recording.command[first:, 0].all()
        np.testing.assert_array_equal(recording.truth[:first], recording.truth[[0] * first])


@pytest.mark.parametrize(
    ("steps", "feedback", "message"),
    [(10, "eyes", "feedback = 'eyes': must be one of truth, raw, ekf"), (0, "ekf", "steps = 0: must be >= 1")],
)
def test_wrong_arguments_of_simulate_are_named(steps, feedback, message):
    with pytest.raises(InvalidValueError) as caught:
        simulate(WorldConfig(), CONTROLLER, ORIGIN, steps, feedback)
    assert str(caught.value) == message


def test_events_that_did_not_happen_are_nan():
    # No fix: the robot does not move.
    case = case_of(QUIET, SensorConfig(fix_rate=0.0), steps=20)
    outcome = outcome_of(case, START)
    assert all(math.isnan(outcome[name]) for name in ("settling_time", "local_time", "estimation_error"))
    assert outcome["path_length"] == outcome["effort"] == outcome["switches"] == 0.0
    # A run that starts at the goal settles at time 0.
    outcome = outcome_of(case_of(QUIET, EXACT, feedback="truth", steps=20), (0.0, 0.0, 0.0))
    assert outcome["settling_time"] == outcome["local_time"] == 0.0
    # The wheel speeds overflow, and the velocity is inf - inf.
    overflowing = PaperConfig(gains=PaperGains(k=1e308))
    outcome = outcome_of(case_of(QUIET, EXACT, overflowing, feedback="truth", steps=5), START)
    assert math.isnan(outcome["x"])
    assert math.isnan(outcome["settling_time"])


CASES = (
    case_of(steps=60),
    case_of(
        PlantConfig(command_delay=0.17, drive_time_constant=0.1, acceleration_max=0.5, slip_noise=0.05),
        SensorConfig(fix_delay=0.2, fix_noise_correlation=0.5),
        feedback="ekf",
        steps=60,
    ),
)
BOX = Starts(np.array([START, (3.0, 1.0, 2.0), (0.0, 7.0, -1.0)]), (1.0, 2.0, 0.3))


@pytest.mark.parametrize("case", CASES, ids=["raw", "actuators, late"])
def test_results_are_equal_to_the_bit_for_any_chunks_and_threads(case, monkeypatch):
    whole, histories = run_batch(case, BOX, 11, 5, 60, threads=1), run_histories(case, BOX, 11, 5, 60, threads=1)
    np.testing.assert_array_equal(histories[:, -1, :3], whole[:, :3])
    for size, threads in ((1, 2), (7, 5), (64, 1)):
        monkeypatch.setattr(batch, "_CHUNK", size)
        monkeypatch.setattr(batch, "_HISTORY_CHUNK", size)
        np.testing.assert_array_equal(run_batch(case, BOX, 11, 5, 60, threads), whole)
        np.testing.assert_array_equal(run_histories(case, BOX, 11, 5, 60, threads), histories)
        for at in range(60 - size, -1, -size):
            np.testing.assert_array_equal(run_batch(case, BOX, 11, 5 + at, size, threads), whole[at : at + size])
    assert run_batch(case, BOX, 1, 0, 0).shape == (0, len(COLUMNS))


def test_starts_are_uniform_in_their_box():
    centre, half = (1.0, -2.0, 3.0), np.array((3.0, 0.5, math.pi))
    case = case_of(QUIET, EXACT, feedback="truth", steps=1)
    poses = [run_histories(case, Starts(np.array([centre]), tuple(half)), seed, 0, 2000)[:, 0, :3] for seed in (1, 2)]
    away = poses[0] - (1.0, -2.0, 0.0)
    assert (np.abs(away) <= half).all()
    np.testing.assert_allclose(away.mean(axis=0) / half, 0.0, atol=0.05)
    np.testing.assert_allclose(away.var(axis=0), half**2 / 3.0, rtol=0.08)
    assert np.abs(np.corrcoef(np.hstack(poses).T) - np.eye(6)).max() < 0.09


@pytest.mark.parametrize(
    ("case", "poses", "message"),
    [
        (case_of(sensors=SensorConfig(fix_delay=1.25)), [START], f"fix_delay = 1.25: {TOO_LATE}"),
        (case_of(sensors=LATE_DETECTOR), [START], f"detection_delay = 1.1: {TOO_LATE}"),
        (case_of(steps=0), [START], "steps = 0: must be >= 1"),
        (
            with_filter(case_of(), FilterConfig(use_gyro=True)),
            [START],
            "use_gyro = True: must be false while gyro_rate is 0",
        ),
        (case_of(), np.empty((0, 3)), "starts = (0, 3): must be (n, 3) with n >= 1"),
    ],
)
def test_wrong_cases_are_refused(case, poses, message):
    with pytest.raises(InvalidValueError) as caught:
        run_batch(case, Starts(np.array(poses)), 1, 0, 1)
    assert str(caught.value) == message
