"""A calibration finds the errors of a simulated robot, and its compiled filter equals the filter of the node.

The tests are in one file because the kernel takes a minute to compile.
"""

import contextlib
import io
import math

import numpy as np
import pytest
import view_bags
import yaml
from calibration_drives import SECOND, Errors, Sensors, events_of, record
from scipy import stats

from diffbot_bag.writer import new_bag
from diffbot_control.filter.config import sources_of
from diffbot_control.filter.measurement import FIXES, heading, landmark, pose_fix
from diffbot_control.filter.odometry import OdometryStep
from diffbot_control.ros.messages.fields import fill_twist_covariance
from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_core.errors import BadMessageError, DiffbotError
from diffbot_core.geometry import Point, Pose, wrap_angle
from diffbot_core.kinematics import Twist, TwistCovariance, body_twist
from diffbot_core.schema import build
from diffbot_sim.config import PlantConfig
from diffbot_sim.noise import MOTION, NoiseSource
from diffbot_sim.plant import command_rows, delayed_command, new_plant, plant_step
from diffbot_tools import cli
from diffbot_tools.bringup import REQUIRED, check_data_sheet
from diffbot_tools.calibration import kernel
from diffbot_tools.calibration.calibrate import calibrate
from diffbot_tools.calibration.command import read_drive, run
from diffbot_tools.calibration.events import Collector, Odometry, with_error_states
from diffbot_tools.calibration.kernel import run_events, settings_of
from diffbot_tools.calibration.latency import latency_of
from diffbot_tools.calibration.quantities import search_settings
from diffbot_tools.parameter_file import read_config
from diffbot_tools.refilter import RecordingLocalization

TRUE = Errors(0.03, -0.03, 0.05, 0.2, 1.5, gyro_bias=0.1)
LIMITS = ", ".join(f"{name}: 0.6" for name in REQUIRED)
PARAMETERS = f"""\
/**: {{ros__parameters: {{{LIMITS}}}}} # the data sheet
/**/ekf: {{ros__parameters: {{gate_probability: 1.0, pose_sources: [{SECOND}], use_gyro: true}}}}
"""


def write_bag(path, recording, commands="/cmd_vel"):
    """Write fixes, odometry, turn rates and commands in the order of their stamps; commands act 0.1 s later."""
    rows = []
    for fix in recording.fixes:
        kind, pose = view_bags.estimate(fix.stamp, *fix.z)
        pose.pose.covariance[[0, 7, 35]] = np.diag(fix.R)
        rows.append(("/global_pose" if fix.source == FIXES else f"/{SECOND}", fix.stamp, (kind, pose)))
    for step in recording.odometry:
        kind, odometry = view_bags.odometry(step.stamp, 0.0, 0.0, 0.0, *step.twist, frame="odom")
        fill_twist_covariance(odometry.twist.covariance, step.covariance)
        rows.append(("/odom", step.stamp, (kind, odometry)))
    for sample in recording.gyro:
        rate, header = {"z": sample.rate}, view_bags.header(sample.stamp, "base_link")
        imu = view_bags.message("sensor_msgs/msg/Imu", header=header, angular_velocity=rate)
        imu[1].angular_velocity_covariance[8] = sample.variance
        rows.append(("/imu", sample.stamp, imu))
    rows += [(commands, stamp - 100_000_000, view_bags.command(*twist)) for stamp, twist in recording.commands]
    view_bags.write(path, sorted(rows, key=lambda row: row[1]))
    (path / "ekf.yaml").write_text(PARAMETERS)
    return path


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    return write_bag(tmp_path_factory.mktemp("data") / "bag", record(TRUE, 1, 60.0, Sensors(second=5, gyro=True)))


@pytest.fixture(scope="module")
def calibrated(bag):
    out, log = bag.parent / "found.yaml", io.StringIO()
    with contextlib.redirect_stderr(log):
        assert run([bag], None, out, math.inf, {}) == 0
    phases = [line.split()[1] for line in log.getvalue().splitlines() if line.startswith("calibrate:")]
    assert phases == ["419", "trying", "trying", "refining", "evaluating"]
    return out


def test_errors_of_the_robot_are_found(calibrated):
    """The tolerances are about three standard deviations."""
    found = yaml.safe_load(calibrated.read_text())["/**/ekf"]["ros__parameters"]
    assert found["odometry_delay"] == pytest.approx(0.2, abs=0.06)
    assert found["left_radius_error"] == pytest.approx(0.03, abs=0.02)
    assert found["right_radius_error"] == pytest.approx(-0.03, abs=0.02)
    assert found["wheel_separation_error"] == pytest.approx(0.05, abs=0.022)
    # The claimed covariances follow from the measured speeds, which have errors.
    assert found["odometry_covariance_scale"] == pytest.approx(1.5**2, rel=0.25)
    assert found["global_pose_sigma_xy"] == pytest.approx(0.075, rel=0.09)
    assert found["global_pose_sigma_yaw"] == pytest.approx(0.045, rel=0.13)
    assert found["pose_source_sigma_xy"] == [pytest.approx(0.075, rel=0.14)]
    assert found["pose_source_sigma_yaw"] == [pytest.approx(0.045, rel=0.2)]
    assert found["gyro_sigma"] == pytest.approx(0.015, rel=0.9)
    assert found["gyro_bias_sigma"] == pytest.approx(0.1, abs=0.01)
    assert found["override_covariance"] is True
    assert found["gate_probability"] == 1.0


def test_the_file_can_be_used_in_place_of_the_given_one(bag, calibrated, capsys, kept_signal_handlers):
    check_data_sheet(calibrated)
    text = calibrated.read_text()
    assert text.startswith("# Calibrated from bag by diffbot calibrate.\n")
    assert "# the data sheet" in text
    config = read_config(calibrated)
    assert config.localization.filter.filter == "ekf_calibrating"
    assert config.noise.override_covariance
    assert cli.main(["calibrate", str(bag), "--out", str(calibrated)]) == 1
    assert "already exists" in capsys.readouterr().err
    assert calibrated.read_text() == text


def test_a_bag_without_a_measured_pose_is_refused_by_topic_and_type(tmp_path):
    """The bag contains odometry alone."""
    path = tmp_path / "bag"
    with new_bag(path) as writer:
        writer.add_topic("/odom", "nav_msgs/msg/Odometry")
        (writer.folder / "ekf.yaml").write_text("/**/ekf: {ros__parameters: {odometry_noise: motion}}")
    with pytest.raises(
        DiffbotError, match=r"no pose meas.*: .*global_pose \(geometry_msgs/msg/PoseWithCov.*landmark_ids"
    ):
        run([path], None, tmp_path / "out.yaml", math.inf, {})


def test_latency_of_the_commands_is_for_the_controller(calibrated):
    """Commands are logged 0.1 s before they act; the plant obeys at once."""
    found = yaml.safe_load(calibrated.read_text())["/**/controller"]["ros__parameters"]
    assert found["command_latency"] + found["drive_time_constant"] == pytest.approx(0.1, abs=0.07)


def test_too_short_a_drive_is_refused_in_one_line(tmp_path):
    short = write_bag(tmp_path / "bag", record(TRUE, seed=2, seconds=5.0, sensors=Sensors(1, second=5, gyro=True)))
    with pytest.raises(DiffbotError, match="s of odometry, at least 10 s are needed") as refused:
        run([short], None, tmp_path / "out.yaml", math.inf, {})
    assert "\n" not in str(refused.value)
    assert not (tmp_path / "out.yaml").exists()


def test_an_acceleration_limit_is_found_and_does_not_add_to_the_dead_time():
    """Drives of the simulated plant at 50 Hz, whose wheels have 5 % of noise."""
    dead, lag, bound = 0.1, 0.1, 0.5
    t_s, rng, held = 0.02, np.random.default_rng(8), Twist(0.0, 0.0)
    plant = PlantConfig(
        sampling_time=t_s, drive_time_constant=lag, acceleration_max=bound, angular_acceleration_max=3.0 * bound
    )
    record, noise = np.zeros((command_rows(dead, t_s), 2)), NoiseSource().run(3, 0, 3000, (MOTION,))
    state, commands, twists = new_plant(Pose(0.0, 0.0, 0.0)), [], []
    for k in range(3000):
        if k % 75 == 0:
            held = Twist(rng.uniform(-0.5, 0.5), rng.uniform(-1.0, 1.0))
        commands.append((k * t_s, *held))
        state = plant_step(state, delayed_command(record, k, held, dead, t_s), noise[:, k], plant)
        twists.append(body_twist(state.encoder, plant.wheels))
    end, twists = t_s * np.arange(1, 3001), np.array(twists)
    odometry = Odometry(end - t_s, end, twists, np.zeros((3000, 3)), np.zeros((0, 2)))
    found = latency_of(np.array(commands), odometry, 0.0)
    assert found.dead_time == pytest.approx(dead, abs=0.02)
    assert found.time_constant == pytest.approx(lag, abs=0.02)
    assert (found.acceleration, found.angular_acceleration) == pytest.approx((bound, 3.0 * bound), rel=0.05)
    assert 0.0 < found.sigma < 0.05


PLACES = (Point(4.0, 1.0), Point(-3.0, 5.0))
WIDE = {
    "detect_correlation": False,
    "wheel_radius_sigma": 0.05,
    "wheel_separation_sigma": 0.05,
    "left_radius_error": 0.01,
    "wheel_separation_error": -0.02,
}
MAP = {"landmark_ids": [1, 2], "landmark_x": [4.0, -3.0], "landmark_y": [1.0, 5.0]}
LANDMARKS = {
    "landmark_range_offset": 0.02,
    "correlation_times": [0.0, 0.0, 1.0],
}


@pytest.fixture(scope="module")
def recording():
    return record(Errors(0.03, -0.02, 0.04), seed=3, seconds=20.0)


def feed(target, odometry, measured, rates=()):
    """Feed odometry steps to a filter, each after the measurements up to its stamp."""
    measured, rates = list(measured), list(rates)
    for step in odometry:
        while rates and rates[0].stamp <= step.stamp:
            target.on_gyro(rates.pop(0))
        while measured and measured[0].stamp <= step.stamp:
            target.on_measurement(measured.pop(0))
        target.on_odometry(step)


def others(recording):
    """Return headings and landmarks with range and bearing or one of them; one landmark in twenty is an outlier."""
    rng, found = np.random.default_rng(5), []
    for index, fix in enumerate(recording.fixes[1:-1]):
        x, y, theta = fix.z
        stamp = fix.stamp + 30_000_000
        found.append(heading(stamp, wrap_angle(theta + 0.05 * rng.normal()), np.array([[0.0025]])))
        place = PLACES[index % 2]
        distance = math.hypot(place.x - x, place.y - y) + 0.1 * rng.normal()
        bearing = wrap_angle(math.atan2(place.y - y, place.x - x) - theta + 0.05 * rng.normal())
        R = np.diag((0.01, 0.0025))
        if index % 5 == 1:
            R[0, 0] = math.inf
        elif index % 5 == 3:
            R[1, 1] = math.inf
        elif index % 20 == 0:
            distance += 3.0
        found.append(landmark(stamp, distance, bearing, R, place))
    return found


CASES = {
    "fixes": ({}, 1, 1e-9),
    "noise of the motion, delay of two messages": (
        {"odometry_noise": "motion", "odometry_delay": 0.2, "correlation_times": [0.0, 1.0]},
        10,
        1e-3,
    ),
    "landmarks alone": ({"odometry_covariance_scale": 4.0, **LANDMARKS}, 10**6, 1e-9),
}
"""Parameters; use every n-th fix; tolerance. Up to the first message, the kernel makes one step, the filter several."""


@pytest.mark.parametrize("case", CASES)
def test_innovations_equal_the_innovations_of_the_filter(recording, case):
    options, keep, tolerance = CASES[case]
    config = build(EkfNodeConfig, WIDE | MAP | options)
    measured = [one for index, one in enumerate(recording.fixes) if index % keep == 0] + others(recording)
    measured.sort(key=lambda one: one.stamp)
    filtered, collector = RecordingLocalization(config), Collector()
    for target in (filtered, collector):
        feed(target, recording.odometry, measured)
    found = run_events(collector.events(case), settings_of(config))
    rows = found.result[found.result[:, kernel.NUMBERS] > 0]
    expected = filtered.innovations
    assert len(rows) == len(expected) > 180
    for row, one in zip(rows, expected, strict=True):
        white = np.linalg.solve(np.linalg.cholesky(one.S), one.y)
        np.testing.assert_allclose(row[kernel.WHITE : kernel.WHITE + len(one.y)], white, atol=tolerance)
    # The kernel ends at the last measurement; only the constant states are the same at the end of the drive.
    x, P = filtered.filter.x[3:], filtered.filter.P[3:, 3:]
    np.testing.assert_allclose(found.x[3:], x, atol=0.01 * tolerance)
    off_diagonal = ~np.eye(len(x), dtype=bool)
    np.testing.assert_allclose(found.P[3:, 3:][off_diagonal], P[off_diagonal], atol=1e-4 * tolerance)


def test_landmarks_without_a_range_or_without_a_bearing_are_used(recording):
    collector = Collector()
    feed(collector, recording.odometry, [recording.fixes[0], *others(recording)])
    found = calibrate([collector.events("landmarks")], build(EkfNodeConfig, MAP), lambda: None)
    factors = dict(zip((one.name for one in found.quantities), np.exp(found.found.values), strict=True))
    assert factors["heading_factor"] == pytest.approx(1.0, rel=0.3)
    assert factors["bearing_factor"] == pytest.approx(1.0, rel=0.3)
    assert found.after.consistency.nis == pytest.approx(1.0, abs=0.3)
    assert abs(found.after.consistency.correlation) < 3.0 * found.after.consistency.bound


def test_figures_are_finite_if_the_odometry_measures_no_motion():
    """The gyro measures turns that the wheels do not measure, as if the wheel separation were 0."""
    events, config = events_of(record(Errors(), seed=7, seconds=30.0, sensors=Sensors(gyro=True))), EkfNodeConfig()
    events = events._replace(odometry=events.odometry._replace(twist=0.0 * events.odometry.twist))
    found = run_events(events, search_settings(settings_of(config), [events], config))
    assert np.isfinite(found.result).all()
    assert np.isfinite(found.P).all()


def test_commands_of_a_robot_in_a_namespace_are_read_with_remap(tmp_path):
    bag = write_bag(tmp_path / "bag", record(Errors(), 1, 15.0, Sensors(second=5, gyro=True)), "/robot1/cmd_vel")
    config = read_config(bag / "ekf.yaml")
    assert len(read_drive(bag, config, math.inf, {})[1]) == 0
    assert len(read_drive(bag, config, math.inf, {"cmd_vel": "robot1/cmd_vel"})[1]) == 150
    with pytest.raises(DiffbotError, match="has no topic /robot2/cmd_vel for cmd_vel"):
        read_drive(bag, config, math.inf, {"cmd_vel": "/robot2/cmd_vel"})


def test_a_drive_whose_first_fix_was_latched_long_before_begins_with_its_odometry():
    collector, R, begin = Collector(), 0.01 * np.eye(3), 1500 * 10**9
    collector.on_measurement(pose_fix(0, Pose(1.0, 2.0, 0.0), R))
    with pytest.raises(BadMessageError, match="long after the first fix"):
        collector.on_odometry(OdometryStep(begin, Twist(0.0, 0.0), TwistCovariance(0.01, 0.0, 0.01)))
    for stamp in range(begin + 10**8, begin + 12 * 10**9, 10**8):
        collector.on_odometry(OdometryStep(stamp, Twist(0.1, 0.0), TwistCovariance(0.01, 0.0, 0.01)))
        collector.on_measurement(pose_fix(stamp, Pose(1.0, 2.0, 0.0), R))
    events = collector.events("latched")
    assert (events.zero, events.odometry.start[0], events.odometry.end[0]) == (begin, 0.0, 0.1)
    assert events.measurements.time[0] == 0.0


def test_likelihood_of_correlated_errors_equals_the_joint_density():
    """The robot stands and turns at random, with two sources of fixes and a far landmark, so the model is linear."""
    rng, dt, var_omega, lasts = np.random.default_rng(6), 0.1, 0.04, (2.0, 0.4, 0.7)
    config = build(EkfNodeConfig, {"filter": "ekf", "pose_sources": ["gps"], "gate_probability": 1.0})
    R, far, collector = np.diag((0.04, 0.09, 0.01)), Point(1e4, 0.0), Collector(sources_of(config.localization))
    variances = R.diagonal(), 2.0 * R.diagonal(), (0.02,)
    collector.on_measurement(pose_fix(0, Pose(0.0, 0.0, 0.0), R))
    rows = []
    for k in range(1, 111):
        stamp = k * 100_000_000
        first, second, (distance,) = (rng.normal(scale=0.1, size=len(one)) for one in variances)
        rows += [(0, k * dt, first), (1, k * dt, second)]
        collector.on_measurement(pose_fix(stamp, Pose(*first), R))
        collector.on_measurement(pose_fix(stamp, Pose(*second), 2.0 * R, "fixes of gps"))
        if k % 3 == 0:
            known = np.diag((0.02, math.inf))
            collector.on_measurement(landmark(stamp, far.x - distance, 0.0, known, far))
            rows.append((2, k * dt, [distance]))
        collector.on_odometry(OdometryStep(stamp, Twist(0.0, 0.0), TwistCovariance(0.0, 0.0, var_omega)))
    settings = settings_of(config)._replace(times=np.array((lasts[0], math.inf, lasts[2], lasts[1])))
    found = run_events(with_error_states(collector.events("joint"), {0, 2, 3}), settings)

    def covariance(one, other, row):
        """Return the covariance of two differences from the first fix: a random walk and Markov processes."""
        (i, t, _), (j, u, _) = one, other
        both = math.exp(-abs(t - u) / lasts[i]) * variances[i][row] if i == j else 0.0
        with_first = sum(math.exp(-at / lasts[0]) for source, at in ((i, t), (j, u)) if source == 0)
        turned = var_omega * dt * min(t, u) if row == 2 else 0.0
        return turned + both + R[row, row] * (1.0 - with_first)

    total = 0.0
    for row in range(3):
        measured = [one for one in rows if row < len(one[2])]
        S = [[covariance(one, other, row) for other in measured] for one in measured]
        total += stats.multivariate_normal(np.zeros(len(S)), S).logpdf([one[2][row] for one in measured])
    assert found.result[:, kernel.TERM].sum() == pytest.approx(total, abs=1e-3)
