"""The controller fed by odometry/filtered instead of pose: as robot_localization sends it, and as the ekf does."""

import time

import graph
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from lockstep_drive import assert_same_path, go
from nav_msgs.msg import Odometry
from robot import distance, lockstep, pose_stamped, robot, turned, twist

from diffbot_control.law.presets import PRESETS
from diffbot_control.ros.message_fields import set_stamp

SIGMAS = PRESETS["tuned"].tolerance.goal_sigmas
FILTERED = {"pose_source": "odometry"}
GOAL = (1.0, 2.0, 0.5)


def test_drives_by_odometry_filtered_as_by_pose():
    goal = (0.0, 0.0, 0.0)
    with lockstep({"seed": 5}, controller=FILTERED) as running:
        assert_same_path(go(running, goal), goal, {"seed": 5})
        received = running.diagnosis("controller")
        running.pause(False)
        running.wait_for_state("goal reached", 20.0)
        running.pause(True)
        end = running.true_pose()
    assert int(received["odometry/filtered received"]) >= 200
    assert "pose received" not in received
    assert distance(end, goal) <= 0.1
    assert turned(end, goal) <= 0.1


@pytest.fixture
def fed():
    """A controller that receives messages from the test alone."""
    with robot(controller=FILTERED, only=("controller",), namespace="/fed") as running:
        running.odometry = running.peer.publisher(Odometry, "odometry/filtered")
        running.peer.wait_for_subscribers(running.odometry)
        running.send_goal(*GOAL)
        yield running


def feed(running, state, variance):
    """Stand at the goal, known to ``variance``, until the controller's state is ``state``; return its status."""
    message = Odometry(child_frame_id="base_link")
    message.header.frame_id = "map"
    message.pose.pose = pose_stamped(*GOAL).pose
    message.pose.covariance[[0, 7, 35]] = variance

    def reported():
        set_stamp(message.header.stamp, time.monotonic_ns())
        running.odometry.publish(message)
        return running.state() == state

    running.peer.spin_until(reported, 5.0, f"the state {state!r}")
    return running.controller_states[-1]


def test_covariance_of_the_odometry_decides_whether_the_goal_is_reached(fed):
    status = feed(fed, "tolerance below uncertainty", 4.0)
    assert status.level == DiagnosticStatus.WARN
    fed.peer.spin_until(lambda: fed.commands, 5.0, "a command")
    assert twist(fed.commands[-1]) == pytest.approx((0.0, 0.0), abs=1e-9)
    values = graph.values(status)
    # Of a deviation of 2 m and 2 rad.
    assert float(values["smallest tolerance [m]"]) == pytest.approx(2.0 * SIGMAS)
    assert float(values["smallest tolerance [rad]"]) == pytest.approx(2.0 * SIGMAS)
    assert values["goals reached"] == "0"
    status = feed(fed, "goal reached", 1e-4)
    assert status.level == DiagnosticStatus.OK
    values = graph.values(status)
    assert float(values["smallest tolerance [m]"]) == pytest.approx(0.01 * SIGMAS)
    assert values["goals reached"] == "1"


def test_a_pose_without_covariance_has_the_uncertainty_of_the_parameters(fed):
    status = feed(fed, "goal reached", 0.0)
    values = graph.values(status)
    # Of a deviation of 0.02 m and 0.02 rad.
    assert float(values["smallest tolerance [m]"]) == pytest.approx(0.02 * SIGMAS)
    assert float(values["smallest tolerance [rad]"]) == pytest.approx(0.02 * SIGMAS)
    output = fed.processes["controller"].output
    assert output.count("covariance is all zero") == 1
    assert "odometry/filtered: covariance is all zero, i.e. unknown: assuming pose_sigma_xy = 0.02 m" in output
    diagnosis = fed.diagnosis("controller")
    received = int(diagnosis["odometry/filtered received"])
    assert received >= 5
    assert int(diagnosis["odometry/filtered with the covariance of the parameters"]) == received
    fed.set_parameter("controller", "pose_sigma_xy", 0.03)
    status = feed(fed, "goal reached", 0.0)
    fed.peer.spin_until(
        lambda: graph.values(fed.controller_states[-1])["smallest tolerance [m]"] == f"{0.03 * SIGMAS:.4f}",
        5.0,
        "the new value",
    )


def test_a_robot_found_far_from_a_held_goal_stands_and_says_why(fed):
    feed(fed, "goal reached", 1e-6)
    fed.peer.spin_until_quiet()
    count = len(fed.commands)
    message = Odometry(child_frame_id="base_link")
    message.header.frame_id = "map"
    message.pose.pose = pose_stamped(GOAL[0] - 8.5, GOAL[1], GOAL[2]).pose
    message.pose.covariance[[0, 7, 35]] = 1e-6

    def let_go():
        set_stamp(message.header.stamp, time.monotonic_ns())
        fed.odometry.publish(message)
        return fed.state() == "idle"

    fed.peer.spin_until(let_go, 5.0, "the state idle")
    reasons = [pair.value for pair in fed.controller_states[-1].values if pair.key == "reason"]
    assert reasons == ["found 8.50 m from the held goal: hold_distance = 0.5 m"]
    fed.peer.spin_until(lambda: let_go() and len(fed.commands) > count + 3, 5.0, "the stop")
    assert {twist(command) for command in fed.commands[count:]} == {(0.0, 0.0)}


def test_a_blocked_robot_gives_up_after_the_time_that_the_status_names_from_the_start(fed):
    status = feed_away(fed, lambda: fed.state() == "driving" and fed.controller_states[-1])
    assert float(graph.values(status)["timeout [s]"]) > 120.0
    status = feed_away(fed, lambda: fed.state() == "goal not reached" and fed.controller_states[-1])
    assert graph.values(status)["reason"].endswith("(derived from distance and limits)")


def feed_away(running, found):
    """Stand 5 m from the goal until ``found``; the stamps run ten times as fast as the time."""
    message = Odometry(child_frame_id="base_link")
    message.header.frame_id = "map"
    message.pose.pose = pose_stamped(GOAL[0] - 5.0, GOAL[1], GOAL[2]).pose
    message.pose.covariance[[0, 7, 35]] = 1e-6

    def fed():
        set_stamp(message.header.stamp, 10 * time.monotonic_ns())
        running.odometry.publish(message)
        return found()

    return running.peer.spin_until(fed, 60.0, "the state")
