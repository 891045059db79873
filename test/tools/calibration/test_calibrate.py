"""A calibration finds the errors that a simulated robot was given, and its compiled filter is the filter itself.

In one file, since the kernel takes a minute to compile.
"""

import contextlib
import io
import math

import numpy as np
import pytest
import yaml
from scipy import stats

from diffbot_bag.bag.encoding import ODOMETRY, POSE, Encoder, NumbersMessage
from diffbot_bag.bag.new_bag import new_bag
from diffbot_control.filter.measurements import FIXES, Heading, LandmarkMeasurement, PoseFix, PositionFix, Source
from diffbot_control.filter.measurements.gyro import GyroRate
from diffbot_control.filter.models import TurnRate
from diffbot_control.filter.odometry import OdometryStep
from diffbot_control.ros.messages.fields import fill_twist_covariance
from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_core.errors import BadMessageError, DiffbotError
from diffbot_core.geometry import Point, Pose, quaternion_of_yaw, wrap_angle
from diffbot_core.kinematics import Twist, TwistCovariance, body_twist
from diffbot_core.schema import build
from diffbot_sim.model.actuators import ActuatorConfig, command_rows, delayed_command
from diffbot_sim.model.philox import NoiseKey
from diffbot_sim.model.plant import PlantConfig, new_plant, plant_step_at
from diffbot_tools import cli
from diffbot_tools.calibration import settings as kernel
from diffbot_tools.calibration.command import run
from diffbot_tools.calibration.events import Collector, Odometry, averaged, with_error_states
from diffbot_tools.calibration.latency import latency_of
from diffbot_tools.calibration.likelihood import Prior, run_events, settings_of
from diffbot_tools.calibration.quantities import given_prior
from diffbot_tools.calibration.simulation import SECOND, Errors, Sensors, record
from diffbot_tools.refilter.filter_run import RecordingLocalization
from diffbot_tools.refilter.parameters import read_config

TRUE = Errors(0.03, -0.03, 0.05, 0.2, 1.5, gyro_bias=0.1)
TWIST, IMU = "geometry_msgs/msg/Twist", "sensor_msgs/msg/Imu"
PARAMETERS = f"/**/ekf: {{ros__parameters: {{gate_probability: 1.0, pose_sources: [{SECOND}], use_gyro: true}}}}"


def write_bag(path, recording, commands=True):
    """Write all but landmarks in the order of the stamps; commands 0.1 s before they are obeyed."""
    odometry, pose, encoder = NumbersMessage(ODOMETRY, "odom", "base_link"), NumbersMessage(POSE, "map"), Encoder()
    rows = []
    for step in recording.odometry:
        odometry.twist[[0, 5]] = step.twist
        fill_twist_covariance(odometry.twist_covariance, step.covariance)
        rows.append((step.stamp, 1, odometry.encode(step.stamp)))
    for fix in recording.fixes:
        pose.position[:2] = fix.pose[:2]
        pose.orientation[2:] = quaternion_of_yaw(fix.pose.theta)
        pose.pose_covariance[[0, 7, 35]] = np.diag(fix.R)
        rows.append((fix.stamp, 0 if fix.source.sensor == FIXES else 3, pose.encode(fix.stamp)))
    for sample in recording.gyro:
        sec, nanosec = divmod(sample.stamp, 10**9)
        message = {
            "header": {"stamp": {"sec": sec, "nanosec": nanosec}},
            "angular_velocity": {"z": sample.rate},
            "angular_velocity_covariance": [0.0] * 8 + [sample.variance],
        }
        rows.append((sample.stamp, 4, encoder.encode(IMU, message)))
    for stamp, twist in recording.commands if commands else ():
        message = {"linear": {"x": twist.v}, "angular": {"z": twist.omega}}
        rows.append((stamp - 100_000_000, 2, encoder.encode(TWIST, message)))
    with new_bag(path) as writer:
        topics = [
            writer.add_topic("/global_pose", POSE),
            writer.add_topic("/odom", ODOMETRY),
            writer.add_topic("/cmd_vel", TWIST),
            writer.add_topic(f"/{SECOND}", POSE),
            writer.add_topic("/imu", IMU),
        ]
        (writer.folder / "ekf.yaml").write_text(PARAMETERS)
        for stamp, topic, data in sorted(rows):
            writer.write(topics[topic], data, stamp, stamp)
    return path


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    return write_bag(tmp_path_factory.mktemp("data") / "bag", record(TRUE, 1, 120.0, Sensors(second=5, gyro=True)))


@pytest.fixture(scope="module")
def calibrated(bag):
    out, said = bag.parent / "found.yaml", io.StringIO()
    with contextlib.redirect_stderr(said):
        assert run([bag], None, out, math.inf, {}) == 0
    phases = [line.split()[1] for line in said.getvalue().splitlines() if line.startswith("calibrate:")]
    assert phases == ["839", "trying", "trying", "refining", "judging"]
    return out


def test_errors_of_the_robot_are_found(calibrated):
    """Within about four deviations of what 120 s determine, each by itself."""
    found = yaml.safe_load(calibrated.read_text())["/**/ekf"]["ros__parameters"]
    assert found["odometry_delay"] == pytest.approx(0.2, abs=0.06)
    assert found["left_radius_error"] == pytest.approx(0.03, abs=0.02)
    assert found["right_radius_error"] == pytest.approx(-0.03, abs=0.02)
    assert found["wheel_separation_error"] == pytest.approx(0.05, abs=0.022)
    # The messages claim what the measured speeds say, which are wrong themselves.
    assert found["odometry_covariance_scale"] == pytest.approx(1.5**2, rel=0.25)
    assert found["global_pose_sigma_xy"] == pytest.approx(0.075, rel=0.09)
    assert found["global_pose_sigma_yaw"] == pytest.approx(0.045, rel=0.13)
    assert found["pose_source_sigma_xy"] == [pytest.approx(0.075, rel=0.14)]
    assert found["pose_source_sigma_yaw"] == [pytest.approx(0.045, rel=0.2)]
    assert found["gyro_sigma"] == pytest.approx(0.015, rel=0.9)
    assert found["gyro_bias_sigma"] == pytest.approx(0.1, abs=0.01)
    assert found["override_covariance"] is True
    assert found["gate_probability"] == 1.0


def test_a_bag_without_a_measured_pose_is_refused_by_topic_and_type(tmp_path):
    """Of odometry and commands alone."""
    path = tmp_path / "bag"
    with new_bag(path) as writer:
        writer.add_topic("/odom", ODOMETRY)
        (writer.folder / "ekf.yaml").write_text("/**/ekf: {ros__parameters: {odometry_noise: motion}}")
    with pytest.raises(DiffbotError, match=r"no pose: .*global_pose \(geometry_msgs/msg/PoseWithCov.*landmark_ids"):
        run([path], None, tmp_path / "out.yaml", math.inf, {})


def test_latency_of_the_commands_is_for_the_controller(calibrated):
    """Commands are logged 0.1 s before they act; the plant obeys at once."""
    found = yaml.safe_load(calibrated.read_text())["/**/controller"]["ros__parameters"]
    assert found["command_latency"] + found["drive_time_constant"] == pytest.approx(0.1, abs=0.07)


def test_file_is_one_that_the_filter_takes_and_is_not_written_over(bag, calibrated, capsys, kept_signal_handlers):
    config, _ = read_config(calibrated)
    assert config.localization.filter.filter == "ekf_calibrating"
    assert config.noise.override_covariance
    assert cli.main(["calibrate", str(bag), "--out", str(calibrated)]) == 1
    assert "exists already" in capsys.readouterr().err
    assert cli.main(["calibrate", "/nowhere/bag", "--out", str(calibrated.parent / "new.yaml")]) == 1
    assert capsys.readouterr().err == "diffbot: no bag /nowhere/bag\n"


@pytest.mark.parametrize(
    ("seconds", "every", "message"),
    [(5.0, 1, "s of odometry, at least 10 s are needed"), (20.0, 40, "measurements while driving")],
)
def test_too_little_is_refused_in_one_line(tmp_path, seconds, every, message):
    short = write_bag(tmp_path / "bag", record(TRUE, seed=2, seconds=seconds, sensors=Sensors(every)), commands=False)
    with pytest.raises(DiffbotError, match=message) as refused:
        run([short], None, tmp_path / "out.yaml", math.inf, {})
    assert "\n" not in str(refused.value)
    assert not (tmp_path / "out.yaml").exists()


def test_a_limit_of_the_acceleration_is_found_and_not_taken_for_dead_time():
    """Drives of the simulated plant at 50 Hz, whose wheels have 5 % of noise."""
    dead, lag, bound = 0.1, 0.1, 0.5
    t_s, rng, held = 0.02, np.random.default_rng(8), Twist(0.0, 0.0)
    actuators = ActuatorConfig(dead, lag, acceleration_max=bound, angular_acceleration_max=3.0 * bound)
    plant, record = PlantConfig(sampling_time=t_s, actuators=actuators), np.zeros((command_rows(dead, t_s), 2))
    state, commands, twists = new_plant(Pose(0.0, 0.0, 0.0)), [], []
    for k in range(3000):
        if k % 75 == 0:
            held = Twist(rng.uniform(-0.5, 0.5), rng.uniform(-1.0, 1.0))
        commands.append((k * t_s, *held))
        state = plant_step_at(NoiseKey(3, 0, k), state, delayed_command(record, k, held, dead, t_s), plant)
        twists.append(body_twist(state.encoder, plant.wheels))
    end = t_s * np.arange(1, 3001)
    found = latency_of(np.array(commands), Odometry(end - t_s, end, np.array(twists), np.zeros((3000, 3))), 0.0)
    assert found.dead_time == pytest.approx(dead, abs=0.02)
    assert found.time_constant == pytest.approx(lag, abs=0.02)
    assert (found.acceleration, found.angular_acceleration) == pytest.approx((bound, 3.0 * bound), rel=0.05)
    assert 0.0 < found.sigma < 0.05


PLACES = (Point(4.0, 1.0), Point(-3.0, 5.0))
WIDE = {
    "detect_correlation": False,
    "wheel_radius_sigma": 0.05,
    "wheel_separation_sigma": 0.05,
    "wheel_radius_walk": 1e-3,
    "landmark_gate": "weigh",
    "left_radius_error": 0.01,
    "wheel_separation_error": -0.02,
}
LANDMARKS = {
    "landmark_range_offset": 0.02, "landmark_range_offset_sigma": 0.1, "landmark_range_scale_sigma": 0.03,
    "landmark_bearing_offset_sigma": 0.02, "landmark_correlation_time": 1.0,
}  # fmt: skip


@pytest.fixture(scope="module")
def recording():
    return record(Errors(0.03, -0.02, 0.04), seed=3, seconds=20.0)


def feed(target, odometry, measured, rates=()):
    """Give a filter the steps of the odometry, each after all that was measured until then."""
    measured, rates = list(measured), list(rates)
    for step in odometry:
        while rates and rates[0].stamp <= step.stamp:
            target.on_gyro(rates.pop(0))
        while measured and measured[0].stamp <= step.stamp:
            target.on_measurement(measured.pop(0))
        target.on_odometry(step)


def others(recording):
    """Headings, and landmarks: both numbers, a range or a bearing, one of twenty misread."""
    rng, found = np.random.default_rng(5), []
    for index, fix in enumerate(recording.fixes[1:-1]):
        x, y, theta = fix.pose
        stamp = fix.stamp + 30_000_000
        found.append(Heading(stamp, wrap_angle(theta + 0.05 * rng.normal()), np.array([[0.0025]])))
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
        found.append(LandmarkMeasurement(stamp, distance, bearing, R, place))
    return found


CASES = {
    "fixes": ({}, 1),
    "motion noise, delay": ({"odometry_noise": "motion", "odometry_delay": 0.2, "fix_correlation_time": 2.0}, 4),
    "density, delay within a message": (
        {
            "odometry_noise": "density",
            "odometry_delay": 0.13,
            "odometry_covariance_scale": 2.0,
            "heading_correlation_time": 1.0,
        },
        10,
    ),
    "landmarks alone": ({"odometry_covariance_scale": 4.0, **LANDMARKS}, 10**6),
}


@pytest.mark.parametrize("case", CASES)
def test_innovations_are_those_of_the_filter(recording, case):
    options, keep = CASES[case]
    config = build(EkfNodeConfig, WIDE | options)
    measured = [one for index, one in enumerate(recording.fixes) if index % keep == 0] + others(recording)
    measured.sort(key=lambda one: one.stamp)
    filtered, collector = RecordingLocalization(config), Collector()
    for target in (filtered, collector):
        feed(target, recording.odometry, measured)
    found = run_events(collector.events(case), given_prior(config), settings_of(config)._replace(split=True))
    rows = found.result[found.result[:, kernel.NUMBERS] > 0]
    expected = filtered.innovations
    assert len(rows) == len(expected) > 180
    np.testing.assert_allclose(rows[:, kernel.NIS], [one.nis for one in expected], rtol=1e-7, atol=1e-10)
    for row, one in zip(rows, expected, strict=True):
        m = len(one.y)
        np.testing.assert_allclose(row[kernel.INNOVATION : kernel.INNOVATION + m], one.y, atol=1e-9)
        white = np.linalg.solve(np.linalg.cholesky(one.S), one.y)
        np.testing.assert_allclose(row[kernel.WHITE : kernel.WHITE + m], white, atol=1e-7)
    belief = filtered.filter.memory.belief
    # The pose is that of the last measurement here; the constant states stay until the end of the drive.
    constant = slice(3, len(belief.x))
    np.testing.assert_allclose(found.x[constant], belief.x[constant], atol=1e-9)
    rest = (belief.P - np.diag(np.diag(belief.P)))[constant, constant]
    np.testing.assert_allclose((found.P - np.diag(np.diag(found.P)))[constant, constant], rest, rtol=1e-6, atol=1e-12)


def test_turn_rates_act_as_in_the_filter():
    """On the innovations of the fixes, the errors of the wheels and the bias; samples and steps end together."""
    recording = record(Errors(0.01, -0.01, 0.02, gyro_bias=0.02), seed=4, seconds=30.0, sensors=Sensors(10, gyro=True))
    config = build(EkfNodeConfig, WIDE | {"use_gyro": True})
    filtered, collector = RecordingLocalization(config), Collector()
    for target in (filtered, collector):
        target.on_measurement(recording.fixes[0])
        feed(target, recording.odometry, recording.fixes[1:], recording.gyro)
    found = run_events(collector.events("gyro"), given_prior(config), settings_of(config)._replace(split=True))
    fixes = [one for one in filtered.innovations if one.source.sensor == "fixes"]
    rows = found.result[found.result[:, kernel.NUMBERS] > 0]
    np.testing.assert_allclose(rows[:, kernel.NIS], [one.nis for one in fixes], rtol=1e-6)
    belief = filtered.filter.memory.belief
    np.testing.assert_allclose(found.x[[3, 4, 5, 9]], belief.x[3:], atol=1e-8)
    np.testing.assert_allclose(found.P[9, 9], belief.P[6, 6], rtol=1e-6)
    assert belief.x[6] == pytest.approx(0.02, abs=0.005)


def test_likelihood_of_correlated_errors_is_the_joint_density():
    """Of two sources of fixes and a far landmark, from a robot that stands and turns at random: all is linear."""
    rng, dt, var_omega, lasts = np.random.default_rng(6), 0.1, 0.04, (2.0, 0.4, 0.7)
    R, far, collector = np.diag((0.04, 0.09, 0.01)), Point(1e4, 0.0), Collector(("gps",))
    variances = R.diagonal(), 2.0 * R.diagonal(), (0.02,)
    collector.on_measurement(PoseFix(0, Pose(0.0, 0.0, 0.0), R))
    rows = []
    for k in range(1, 111):
        stamp = k * 100_000_000
        first, second, (distance,) = (rng.normal(scale=0.1, size=len(one)) for one in variances)
        rows += [(0, k * dt, first), (1, k * dt, second)]
        collector.on_measurement(PoseFix(stamp, Pose(*first), R))
        collector.on_measurement(PoseFix(stamp, Pose(*second), 2.0 * R, Source("fixes of gps")))
        if k % 3 == 0:
            known = np.diag((0.02, math.inf))
            collector.on_measurement(LandmarkMeasurement(stamp, far.x - distance, 0.0, known, far))
            rows.append((2, k * dt, [distance]))
        collector.on_odometry(OdometryStep(stamp, Twist(0.0, 0.0), TwistCovariance(0.0, 0.0, var_omega)))
    config = build(EkfNodeConfig, {"pose_sources": ["gps"], "gate_probability": 1.0})
    settings = settings_of(config)._replace(times=np.array((math.inf, lasts[2], *lasts[:2])), walk=0.0)
    events = with_error_states(collector.events("joint"), {1, 2, 3})
    found = run_events(events, Prior(np.zeros(6), np.zeros(6)), settings)

    def covariance(one, other, row):
        """Of two differences from the first fix, by a random walk and Markov processes."""
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


def test_a_landmark_takes_the_states_of_the_one_that_was_not_seen_for_the_longest_time():
    """A measurement whose error before is no state any more has no neighbour."""
    for count, gap in ((10, 1.0), (40, math.inf)):
        collector = Collector()
        collector.on_measurement(PoseFix(0, Pose(0.0, 0.0, 0.0), np.eye(3)))
        for k in range(1, 161):
            stamp = k * 100_000_000
            place = Point(float(k % count), 3.0)
            collector.on_measurement(LandmarkMeasurement(stamp, 2.0, 0.1, np.eye(2), place))
            collector.on_odometry(OdometryStep(stamp, Twist(0.1, 0.0), TwistCovariance(0.1, 0.0, 0.1)))
        measured = with_error_states(collector.events("many"), {1}).measurements
        seen = measured.time > 8.0
        np.testing.assert_allclose(measured.gap[seen], gap)
        for slot in set(measured.slot[seen].tolist()):
            assert len(set(map(tuple, measured.place[seen & (measured.slot == slot)]))) == (1 if count == 10 else 5)


def test_averaged_odometry_keeps_the_way_and_its_variance(recording):
    collector = Collector()
    feed(collector, recording.odometry, recording.fixes)
    fine = collector.events("fine")
    coarse = averaged(fine, 0.5)
    for events in (fine, coarse):
        np.testing.assert_allclose(events.odometry.start[1:], events.odometry.end[:-1])
    assert len(coarse.odometry.end) == 40
    sums = []
    for events in (fine, coarse):
        dt = (events.odometry.end - events.odometry.start)[:, None]
        way, variance = events.odometry.twist * dt, events.odometry.covariance * dt * dt
        sums.append([*way.sum(axis=0), *variance.sum(axis=0)])
    np.testing.assert_allclose(sums[0], sums[1])


def test_a_drive_may_start_from_a_position_and_what_the_kernel_does_not_know_is_dropped():
    collector = Collector()
    with pytest.raises(BadMessageError, match="no fix yet"):
        collector.on_measurement(Heading(0, 0.1, np.eye(1)))
    collector.on_measurement(PositionFix(0, 1.0, 2.0, np.diag([0.04, 0.09])))
    (start,) = collector.resets
    assert start.pose == Pose(1.0, 2.0, 0.0)
    np.testing.assert_allclose(start.R, np.diag([0.04, 0.09, math.pi**2]))
    with pytest.raises(BadMessageError, match="not used by the calibration"):
        collector.on_measurement(
            GyroRate(1, TurnRate(0.1, 1e-4), Twist(0.5, 0.1), TwistCovariance(1e-3, 0.0, 1e-3), 0.6)
        )
