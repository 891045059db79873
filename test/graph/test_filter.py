"""The ekf in the graph: how it starts, what it fuses, what it reports, and what it keeps across a restart."""

import json
import math

import numpy as np
import one_process
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from filter_input import fix, odometry, timed
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from robot import DEEP, LATCHED, distance, planar, stamp, turned
from sensor_msgs.msg import PointCloud2, PointField
from std_srvs.srv import Trigger

from diffbot_control.ekf_node import EkfNode
from diffbot_control.ros.messages.landmark_cloud import LandmarkPoint, fill_landmark_points

LANDMARKS = {"landmark_ids": [7, 3, -2], "landmark_x": [3.0, -4.0, 0.5], "landmark_y": [2.0, 1.0, -3.0]}
START_POSE = (1.0, 2.0, 0.5)


class Filter(one_process.Fed):
    """An ekf alone, with the test as its sensors and its clock."""

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
    """Return a function that starts an ekf; the one before it ends as by a signal."""
    running = []

    def begin(parameters=None):
        while running:
            node = running.pop().node
            node.before_shutdown()
            nodes.remove(node)
        running.append(Filter(nodes, parameters))
        return running[-1]

    return begin


def test_odometry_alone_starts_nothing_and_initialpose_does(start):
    subject = start()
    subject.send("odom", odometry(subject.time))
    assert (subject.node.state(), subject.poses) == ("waiting for first fix", [])
    subject.send("initialpose", fix(subject.time, -2.0, 1.0, 2.0))
    assert subject.move()[0] == pytest.approx((-2.0, 1.0, 2.0), abs=1e-6)
    # If this process was held up for longer than sensor_timeout, the filter has missed odometry: it gets more.
    subject.peer.spin_until(lambda: subject.move() and subject.node.state() == "running", what="running")
    # A second one moves the filter wherever that is.
    subject.send("initialpose", fix(subject.time, 90.0, 9.0, 0.0))
    assert subject.move()[0] == pytest.approx((90.0, 9.0, 0.0), abs=1e-6)
    assert subject.peer.call(Trigger, "ekf/reset").success
    assert (subject.node.state(), subject.node.health.report(1.0)) == ("waiting for first fix", {})
    assert subject.start(*START_POSE)[0] == pytest.approx(START_POSE, abs=1e-6)
    states = subject.peer.subscribe(DiagnosticStatus, "ekf/status", LATCHED)
    subject.peer.spin_until(lambda: states and states[-1].message == "no odometry", what="the silence in the status")


def test_known_wheels_count_in_pose_and_twist_are_kept_across_a_restart_and_forgotten_by_a_reset(
    start, tmp_path, capfd
):
    """Both wheels are known to be 2 % too large."""
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
    # An initial pose keeps what is known of the wheels.
    again.send("initialpose", fix(again.time, 4.0, 5.0, -1.0))
    again.move()
    assert again.node.details()["right wheel radius error"].startswith("+0.0200")
    assert again.peer.call(Trigger, "ekf/reset").success
    start()
    assert not path.exists()
    assert "state_file" not in capfd.readouterr().err


def test_a_broken_state_file_that_cannot_be_renamed_is_one_error_and_stays_as_it_is(start, tmp_path, capfd):
    path = tmp_path / "ekf.json"
    path.write_text("my only copy of something else")
    # Nothing can be renamed to a folder; root may write into any.
    (tmp_path / "ekf.json.bad").mkdir()
    subject = start({"state_file": str(path)})
    assert subject.start(*START_POSE)[0] == pytest.approx(START_POSE, abs=1e-6)
    start()
    assert path.read_text() == "my only copy of something else"
    errors = [one for one in capfd.readouterr().err.splitlines() if "[ERROR]" in one]
    assert len(errors) == 1
    assert f"it will not be saved: {path} is not a JSON file; the file cannot be renamed: Is a directory" in errors[0]


def cloud(time, points):
    message = timed(PointCloud2(), time)
    message.header.frame_id = "base_link"
    fill_landmark_points(message, points, PointField)
    return message


def seen(number, pose):
    """Return landmark ``number`` as a robot at ``pose`` measures it."""
    index = LANDMARKS["landmark_ids"].index(number)
    dx, dy = LANDMARKS["landmark_x"][index] - pose[0], LANDMARKS["landmark_y"][index] - pose[1]
    return LandmarkPoint(number, math.hypot(dx, dy), math.atan2(dy, dx) - pose[2], 4e-4, 1e-4)


def test_landmarks_are_fused_by_their_numbers_and_strangers_are_counted(start):
    subject, truth = start(LANDMARKS), (1.0, 2.0, 0.0)
    subject.start(1.1, 2.1, 0.05)
    for _ in range(20):
        points = [seen(7, truth), seen(3, truth), LandmarkPoint(99, 1.0, 1.0, 4e-4, 1e-4)]
        subject.send("landmarks", cloud(subject.time + 0.05, points))
        pose, P = subject.move()
    assert distance(pose, truth) < 0.02
    assert turned(pose, truth) < 0.02
    assert np.linalg.eigvalsh(P).max() < 0.02**2
    assert subject.node.health.counted["landmarks with unknown ids"] == 20
    assert not subject.node.health.dropped
