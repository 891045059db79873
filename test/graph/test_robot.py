"""The robot starts, talks and ends: topics, frames, reports, and the log of a run without faults."""

import signal

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseWithCovarianceStamped, Twist
from nav_msgs.msg import Odometry
from robot import robot, yaw
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Float64MultiArray

TOPICS = {
    "cmd_vel": Twist,
    "odom": Odometry,
    "global_pose": PoseWithCovarianceStamped,
    "heading": Imu,
    "ground_truth": Odometry,
    "joint_states": JointState,
    "pose": PoseWithCovarianceStamped,
    "odometry/filtered": Odometry,
    "controller/navigation": Float64MultiArray,
    "controller/status": DiagnosticStatus,
    "ekf/status": DiagnosticStatus,
    "/diagnostics": DiagnosticArray,
}
SILENT = {
    *("goal_pose", "path", "initialpose", "imu", "landmarks", "clock", "tf"),
    *("controller/transition_event", "ekf/transition_event"),
    *("controller/goal_status", "controller/goal_results", "controller/goal_feedback"),
}
"""Topics of the design without a message in this drive."""


def test_every_topic_of_the_design_has_messages_and_no_other_one_exists():
    with robot({"heading_rate": 10.0, "heading_error_max": 0.0, "initial_pose.yaw": 1.0}) as walking:
        peer = walking.peer
        received = {name: peer.subscribe(kind, name) for name, kind in TOPICS.items()}
        peer.spin_until(lambda: received["heading"], what="a heading")
        heading = received["heading"][0]
        assert yaw(heading.orientation) == pytest.approx(1.0, abs=1e-12)
        assert heading.angular_velocity_covariance[0] == heading.linear_acceleration_covariance[0] == -1.0
        walking.send_goal(3.0, 1.0, 0.5)
        peer.spin_until(lambda: all(received.values()), what=f"a message on each of {sorted(received)}")
        for name, frame in (("odom", "odom"), ("heading", "base_link")):
            assert received[name][0].header.frame_id == frame
        assert received["odom"][0].child_frame_id == "base_link"
        for name in ("global_pose", "ground_truth", "pose", "odometry/filtered"):
            assert received[name][0].header.frame_id == "map"
        navigation = received["controller/navigation"][0]
        labels = [dim.label for dim in navigation.layout.dim]
        assert labels == ["stamp", "rho", "alpha", "beta", "theta", "eps_P", "region", "V"]
        assert len(navigation.data) == len(labels)
        known = {name.lstrip("/") for name in TOPICS} | SILENT | {"parameter_events", "rosout"}
        assert {name.lstrip("/") for name, _ in peer.node.get_topic_names_and_types()} <= known
        first, second = walking.diagnoses("controller", 2)
        assert int(second["cmd_vel sent"]) > int(first["cmd_vel sent"])
        assert float(second["cmd_vel sent [Hz]"]) > 0.0
        statuses = {name: process.stop(signal.SIGINT) for name, process in walking.processes.items()}
        assert statuses == dict.fromkeys(statuses, 0)
        lines = [line for process in walking.processes.values() for line in process.output.splitlines()]
    # An odometry may come before the first fix, and the plant ends while the robot drives.
    harmless = "no fix yet", "stale pose"
    odd = [line for line in lines if not line.startswith("[INFO]") and not any(text in line for text in harmless)]
    assert not odd
