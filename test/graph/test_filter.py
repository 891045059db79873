"""The ekf over DDS: its start, the fusion of landmarks, its reports, and what it keeps across a restart."""

import json
import time

import numpy as np
import one_process
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from filter_input import START, fix, odometry, timed
from geometry_msgs.msg import PoseWithCovarianceStamped
from inside import inside
from nav_msgs.msg import Odometry
from robot import DEEP, LATCHED, distance, initialpose, planar, stamp
from sensor_msgs.msg import Imu
from std_srvs.srv import Trigger

from diffbot_control.ekf_node import EkfNode
from diffbot_core.geometry import Pose, out_of_frame

START_POSE = (1.0, 2.0, 0.5)


class Filter(one_process.Fed):
    """An ekf whose sensors and clock are the test."""

    def __init__(self, nodes, parameters=None):
        super().__init__(nodes, EkfNode, {"reliable_inputs": True, **(parameters or {})})
        self.poses = self.peer.subscribe(PoseWithCovarianceStamped, "pose", DEEP)
        self.filtered = self.peer.subscribe(Odometry, "odometry/filtered", DEEP)
        self.time = 1000.0

    def move(self, v=0.0, omega=0.0):
        """Send the odometry of a tenth of a second; return the pose that answers it and its covariance."""
        self.time = round(self.time + 0.1, 3)
        self.send("odom", odometry(self.time, v, omega))
        self.peer.spin_until(lambda: self.poses and stamp(self.poses[-1]) == round(self.time * 1e9), what="the pose")
        P = np.array(self.poses[-1].pose.covariance).reshape(6, 6)
        return planar(self.poses[-1].pose.pose), P[np.ix_([0, 1, 5], [0, 1, 5])]

    def start(self, *pose):
        self.send("global_pose", fix(self.time, *pose))
        return self.move()


@pytest.fixture
def start(nodes):
    """Return a function that ends the previous ekf as a signal does, and starts a new ekf."""
    running = []

    def begin(parameters=None):
        while running:
            node = running.pop().node
            node.before_shutdown()
            nodes.remove(node)
        running.append(Filter(nodes, parameters))
        return running[-1]

    return begin


def test_the_filter_starts_at_an_initial_pose_and_not_with_odometry_alone(start):
    subject = start()
    subject.send("odom", odometry(subject.time))
    assert (subject.node.state(), subject.poses) == ("waiting for first fix", [])
    subject.send("initialpose", fix(subject.time, -2.0, 1.0, 2.0))
    assert subject.move()[0] == pytest.approx((-2.0, 1.0, 2.0), abs=1e-6)
    # If this process was held up for longer than sensor_timeout, the filter has missed odometry.
    subject.peer.spin_until(lambda: subject.move() and subject.node.state() == "running", what="running")
    # A second initial pose moves the filter, however far.
    subject.send("initialpose", fix(subject.time, 90.0, 9.0, 0.0))
    assert subject.move()[0] == pytest.approx((90.0, 9.0, 0.0), abs=1e-6)
    assert subject.peer.call(Trigger, "ekf/reset").success
    assert (subject.node.state(), subject.node.health.report(1.0)) == ("waiting for first fix", {})
    assert subject.start(*START_POSE)[0] == pytest.approx(START_POSE, abs=1e-6)
    states = subject.peer.subscribe(DiagnosticStatus, "ekf/status", LATCHED)
    subject.peer.spin_until(lambda: states and states[-1].message == "no odometry", what="the silence in the status")


def test_wheel_errors_correct_pose_and_twist_and_are_kept_by_a_restart_and_deleted_by_a_reset(start, tmp_path, capfd):
    """The estimate says that both wheels are 2 % too large."""
    path = tmp_path / "ekf.json"
    content = {"version": 1, "pose": [2, 1, 0.5], "P": np.diag([0.01] * 3).tolist(), "geometry": [0.05, 0.6]}
    content |= {"wheels": [0.02, 0.02, 0.0], "wheels_P": np.diag([1e-8] * 3).tolist()}
    path.write_text(json.dumps(content))
    parameters = {"state_file": str(path)}
    subject = start(parameters)
    before, _ = subject.move(0.5)
    after, P = subject.move(0.5)
    now = round(subject.time * 1e9)
    newest = subject.peer.spin_until(
        lambda: next((one for one in subject.filtered if stamp(one) == now), None), what="its twist"
    )
    assert planar(newest.pose.pose) == after
    assert np.array(newest.pose.covariance) == pytest.approx(np.array(subject.poses[-1].pose.covariance))
    assert newest.child_frame_id == "base_link"
    assert newest.twist.twist.linear.x == pytest.approx(0.51, abs=1e-3)
    assert distance(before, after) == pytest.approx(0.051, abs=1e-4)
    assert np.linalg.eigvalsh(P)[0] > 0.0
    again = start(parameters)
    again.time += 100.0
    assert again.node.state() == "no odometry"
    assert again.move()[0] == pytest.approx(after, abs=1e-6)
    assert again.node.details()["right wheel radius error"].startswith("+0.0200")
    # An initial pose does not change the estimated wheel errors.
    again.send("initialpose", fix(again.time, 4.0, 5.0, -1.0))
    again.move()
    assert again.node.details()["right wheel radius error"].startswith("+0.0200")
    assert again.peer.call(Trigger, "ekf/reset").success
    start()
    assert not path.exists()
    assert "state_file" not in capfd.readouterr().err


def test_a_broken_state_file_that_cannot_be_renamed_is_one_error_and_does_not_change(start, tmp_path, capfd):
    path = tmp_path / "ekf.json"
    path.write_text("my only copy of something else")
    # A file cannot be renamed to a folder. Missing permissions would not stop root.
    (tmp_path / "ekf.json.bad").mkdir()
    subject = start({"state_file": str(path)})
    assert subject.start(*START_POSE)[0] == pytest.approx(START_POSE, abs=1e-6)
    start()
    assert path.read_text() == "my only copy of something else"
    errors = [one for one in capfd.readouterr().err.splitlines() if "[ERROR]" in one]
    assert len(errors) == 1
    assert f"it will not be saved: {path} is not a JSON file; the file cannot be renamed: Is a directory" in errors[0]


def test_the_filter_starts_from_an_old_latched_fix_and_again_after_a_reset(nodes):
    """AMCL latches its pose and publishes again only after a motion."""
    latched = nodes.peer.publisher(PoseWithCovarianceStamped, "global_pose", LATCHED)
    nodes.peer.publisher(PoseWithCovarianceStamped, "global_pose")  # does not latch
    latched.publish(fix(time.time() - 2000.0, 2.0, 1.0, 0.5))
    fed = one_process.Fed(nodes, EkfNode, {"sensor_timeout": 600.0})

    def runs():
        fed.send("odom", odometry(time.time(), 0.0, 0.0, (0.0, 0.0, 0.0)))
        return fed.node.state() == "running"

    nodes.peer.spin_until(runs, what="the start")
    assert fed.node.localization.estimate().pose == pytest.approx((2.0, 1.0, 0.5), abs=1e-6)
    nodes.peer.spin_until(lambda: not fed.node._latched, what="the end of the second subscription")
    # Later fixes are received once.
    latched.publish(fix(time.time(), 2.01, 1.0, 0.5))
    nodes.peer.spin_until(lambda: fed.node.health.accepted["global_pose"], what="the next fix")
    assert not fed.node.health.dropped["global_pose", "duplicate"]
    assert nodes.peer.call(Trigger, "ekf/reset").success
    nodes.peer.spin_until(runs, what="the start after a reset")
    fed.node.restart()  # before the end of the second subscription
    nodes.peer.spin_until(runs, what="the start after the next reset")


def imu(time, rate):
    message = timed(Imu(), time)
    message.angular_velocity.z = rate
    message.angular_velocity_covariance[8] = 2.5e-5
    return message


def test_a_silent_gyro_and_a_gyro_that_contradicts_the_wheels_are_reported(nodes):
    fed = one_process.Fed(nodes, EkfNode, {"use_gyro": True, "sensor_timeout": 600.0, "reliable_inputs": True})

    def drive(first, last, rate=None):
        for step in range(first, last):
            if rate is not None:
                fed.send("imu", imu(START + 0.1 * step, rate))
            fed.send("odom", odometry(START + 0.1 * step, omega=0.1))
        fed.node._check_and_report()  # its timer may not have expired since the last message
        return fed.node.health_level()

    fed.send("global_pose", fix())
    level, text = drive(1, 4)
    assert level == 1
    assert "no turn rate on imu" in text
    assert drive(4, 30, 0.1)[0] == 0
    level, text = drive(30, 70, 2.0)
    assert level == 1
    assert "wheels and gyro contradict each other" in text
    assert drive(70, 110, 0.1)[0] == 0


SLIP = {"slip_right": 0.6, "slip_start": 2.0, "slip_duration": 3.0}
STEPS = 200
"""20 s"""


def test_known_landmarks_and_gyro_keep_the_estimate_while_a_wheel_slips_and_the_gyro_bias_is_estimated():
    begin = Pose(-2.0, -1.0, 0.3)
    x, y = [5.0, 5.0, -5.0], [5.0, -5.0, 0.0]
    landmarks = {"landmark_ids": [7, 3, -2], "landmark_x": x, "landmark_y": y}
    measured = {"landmark_ids": [7, 3, -2, 99], "landmark_x": [*x, 0.0], "landmark_y": [*y, 1.0]}
    sensors = {"fix_rate": 0.0, "landmark_rate": 10.0, "gyro_rate": 10.0, "gyro_bias": 0.03}
    start = {"initial_pose.x": begin.x, "initial_pose.y": begin.y, "initial_pose.yaw": begin.theta}
    with inside({**start, **sensors, **SLIP, **measured}, {**landmarks, "use_gyro": True}) as robot:
        odometries = robot.peer.subscribe(Odometry, "odom", DEEP)
        poses = robot.peer.publisher(PoseWithCovarianceStamped, "initialpose")
        robot.peer.wait_for_subscribers(poses)
        poses.publish(initialpose(*begin))
        robot.send_goal(3.0, 2.0, 0.5)
        robot.run(lambda: len(robot.poses) > STEPS, "the drive")
        report = robot.diagnosis("ekf")
        truths = {stamp(one): planar(one.pose.pose) for one in robot.truths}
        known = [one for one in robot.poses if stamp(one) in truths]
        errors = [distance(planar(one.pose.pose), truths[stamp(one)]) for one in known]
        by_wheels = {stamp(one): out_of_frame(Pose(*planar(one.pose.pose)), begin) for one in odometries}
        errors_of_wheels = [distance(pose, truths[when]) for when, pose in by_wheels.items() if when in truths]
    assert len(errors) > 0.9 * STEPS
    assert np.mean(errors) < 0.05
    assert np.mean(errors_of_wheels) > 3.0 * np.mean(errors)
    assert int(report["landmarks received"]) > 0.9 * STEPS
    assert int(report["landmarks with unknown ids"]) > 0.9 * STEPS
    assert int(report["imu received"]) > 0.9 * STEPS
    bias, deviation = (float(one) for one in report["gyro bias"].split(" +- "))
    assert abs(bias - 0.03) < 4.0 * deviation < 0.03
    assert int(report["odometry steps against the gyro"]) > 5
