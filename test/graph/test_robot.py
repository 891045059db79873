"""The robot starts, talks and ends."""

import signal

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseWithCovarianceStamped, Twist
from nav_msgs.msg import Odometry
from robot import robot, yaw
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Float64MultiArray


@pytest.fixture(scope="module")
def walking():
    with robot() as running:
        running.send_goal(3.0, 1.0, 0.5)
        yield running


TOPICS = {
    "cmd_vel": Twist,
    "odom": Odometry,
    "global_pose": PoseWithCovarianceStamped,
    "ground_truth": Odometry,
    "joint_states": JointState,
    "pose": PoseWithCovarianceStamped,
    "odometry/filtered": Odometry,
    "controller/navigation": Float64MultiArray,
    "controller/status": DiagnosticStatus,
    "ekf/status": DiagnosticStatus,
    "/diagnostics": DiagnosticArray,
}


def test_every_topic_of_the_design_carries_messages(walking):
    received = {name: walking.peer.subscribe(kind, name) for name, kind in TOPICS.items()}
    walking.peer.spin_until(lambda: all(received.values()), 10.0, f"a message on each of {sorted(received)}")
    assert received["odom"][0].header.frame_id == "odom"
    assert received["odom"][0].child_frame_id == "base_link"
    for name in ("global_pose", "ground_truth", "pose", "odometry/filtered"):
        assert received[name][0].header.frame_id == "map"
    labels = [dim.label for dim in received["controller/navigation"][0].layout.dim]
    assert labels == ["stamp", "rho", "alpha", "beta", "theta", "eps_P", "region", "V"]
    assert len(received["controller/navigation"][0].data) == len(labels)


def test_no_node_hears_or_sends_a_topic_that_is_not_in_the_design(walking):
    known = {name.lstrip("/") for name in TOPICS} | {
        *("goal_pose", "path", "initialpose", "heading", "landmarks", "clock", "tf"),
        *("controller/transition_event", "ekf/transition_event"),
        *("controller/goal_status", "controller/goal_results", "controller/goal_feedback"),
    }

    def others():
        found = {name.lstrip("/") for name, _ in walking.peer.node.get_topic_names_and_types()}
        # rclpy keeps this publisher of a lifecycle node until the process ends, here that of other tests.
        found = {name for name in found if not name.endswith("/transition_event")}
        return found - known - {"parameter_events", "rosout"}

    # Nodes that were killed before may stay listed for 20 s.
    walking.peer.spin_until(lambda: not others(), 30.0, f"the end of {others()}")


def test_diagnostics_come_once_a_second_with_rates(walking):
    first, second = walking.diagnoses("controller", 2)
    sent = int(second["cmd_vel sent"]) - int(first["cmd_vel sent"])
    assert 7 <= sent <= 13
    assert 7.0 <= float(second["cmd_vel sent [Hz]"]) <= 13.0
    assert int(walking.diagnosis("plant")["steps"]) > 0


def test_heading_is_an_imu_message_with_a_yaw_only():
    plant = {"heading_rate": 10.0, "heading_error_max": 0.0, "initial_pose.yaw": 1.0}
    with robot(plant, only=("plant",), namespace="/other") as one:
        received = one.peer.subscribe(Imu, "heading")
        one.peer.spin_until(lambda: received, 5.0, "heading")
    assert yaw(received[0].orientation) == pytest.approx(1.0, abs=1e-12)
    assert received[0].angular_velocity_covariance[0] == -1.0
    assert received[0].linear_acceleration_covariance[0] == -1.0
    assert received[0].header.frame_id == "base_link"


def test_all_processes_end_with_status_0_and_leave_nothing_on_stderr_but_their_log():
    with robot(namespace="/other") as one:
        one.peer.spin_until(lambda: len(one.poses) > 3, 5.0, "poses")
        processes = dict(one.processes)
        statuses = {name: process.stop(signal.SIGINT) for name, process in processes.items()}
        output = "\n".join(process.output for process in processes.values())
    assert statuses == dict.fromkeys(statuses, 0)
    # An odometry may come before the first fix.
    odd = [line for line in output.splitlines() if line and not line.startswith("[INFO]") and "no fix yet" not in line]
    assert not odd
