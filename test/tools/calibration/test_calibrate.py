"""A calibration finds the errors that a simulated robot was given, from a bag, and writes what the filter reads."""

import contextlib
import io
import math

import numpy as np
import pytest
import yaml

from diffbot_bag.bag.encoding import ODOMETRY, POSE, Encoder, NumbersMessage
from diffbot_bag.bag.new_bag import new_bag
from diffbot_control.ros.messages.fields import fill_twist_covariance
from diffbot_core.errors import DiffbotError
from diffbot_core.geometry import Pose, quaternion_of_yaw
from diffbot_core.kinematics import Twist, body_twist
from diffbot_sim.model.actuators import ActuatorConfig, command_rows, delayed_command
from diffbot_sim.model.philox import NoiseKey
from diffbot_sim.model.plant import PlantConfig, new_plant, plant_step_at
from diffbot_tools import cli
from diffbot_tools.calibration.command import run
from diffbot_tools.calibration.events import Odometry
from diffbot_tools.calibration.latency import latency_of
from diffbot_tools.calibration.simulation import Errors, record
from diffbot_tools.refilter.parameters import read_config

TRUE = Errors(0.03, -0.03, 0.05, 0.2, 3.0)
TWIST = "geometry_msgs/msg/Twist"


def write_bag(path, recording, commands=True):
    """Write odometry, fixes and commands in the order of their stamps; commands 0.1 s before they are obeyed."""
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
        rows.append((fix.stamp, 0, pose.encode(fix.stamp)))
    for stamp, twist in recording.commands if commands else ():
        message = {"linear": {"x": twist.v}, "angular": {"z": twist.omega}}
        rows.append((stamp - 100_000_000, 2, encoder.encode(TWIST, message)))
    with new_bag(path) as writer:
        topics = [
            writer.add_topic("/global_pose", POSE),
            writer.add_topic("/odom", ODOMETRY),
            writer.add_topic("/cmd_vel", TWIST),
        ]
        (writer.folder / "ekf.yaml").write_text("/**/ekf: {ros__parameters: {gate_probability: 1.0}}")
        for stamp, topic, data in sorted(rows):
            writer.write(topics[topic], data, stamp, stamp)
    return path


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    return write_bag(tmp_path_factory.mktemp("data") / "bag", record(TRUE, seed=1, seconds=120.0))


@pytest.fixture(scope="module")
def calibrated(bag):
    out, said = bag.parent / "found.yaml", io.StringIO()
    with contextlib.redirect_stderr(said):
        assert run([bag], None, out, math.inf, {}) == 0
    assert [line.split()[1] for line in said.getvalue().splitlines()] == ["600", "trying", "refining", "judging"]
    return out


def test_errors_of_the_robot_are_found(calibrated):
    """Within about four deviations of what 120 s determine, each by itself."""
    found = yaml.safe_load(calibrated.read_text())["/**/ekf"]["ros__parameters"]
    assert found["odometry_delay"] == pytest.approx(0.2, abs=0.06)
    assert found["left_radius_error"] == pytest.approx(0.03, abs=0.02)
    assert found["right_radius_error"] == pytest.approx(-0.03, abs=0.02)
    assert found["wheel_separation_error"] == pytest.approx(0.05, abs=0.022)
    # A variance: its logarithm has the deviation 0.4.
    assert math.log(found["odometry_covariance_scale"]) == pytest.approx(math.log(9.0), abs=1.6)
    assert found["global_pose_sigma_xy"] == pytest.approx(0.15, rel=0.09)
    assert found["global_pose_sigma_yaw"] == pytest.approx(0.09, rel=0.13)
    assert found["override_covariance"] is True
    assert found["gate_probability"] == 1.0


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
    short = write_bag(tmp_path / "bag", record(TRUE, seed=2, seconds=seconds, fixes_every=every), commands=False)
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
