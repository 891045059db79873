"""Driving to goals: reaching, changing, cancelling and holding them; and two robots on one domain."""

import itertools
import math

import pytest
from geometry_msgs.msg import TwistStamped
from robot import SIMULATED, distance, planar, robot, stamp, turned, twist

STANDING = 0.05
"""[m/s] the commands at a reached goal are below it most of the time"""


@pytest.fixture(scope="module")
def fast():
    """A robot at five times the pace of the wall clock, which starts where the paper's scenario A does."""
    plant = {"clock": "scaled", "real_time_factor": 5.0, "seed": 3}
    with robot(plant, SIMULATED, SIMULATED) as running:
        running.peer.spin_until(lambda: running.truths and running.poses, 10.0, "the first poses")
        yield running


def drive(robot, goal, timeout=25.0):
    robot.send_goal(*goal)
    robot.wait_for_state("goal reached", timeout)


def settle(robot, seconds=2.0):
    """Let simulated seconds pass."""
    robot.catch_up()
    end = stamp(robot.truths[-1]) + seconds * 1e9
    robot.peer.spin_until(lambda: stamp(robot.truths[-1]) >= end, 15.0, "simulated time")


@pytest.mark.parametrize("goal", [(0.0, 0.0, 0.0), (2.0, 3.0, math.pi / 2), (-1.0, 1.0, math.pi)])
def test_reaches_a_goal_and_says_so(fast, goal):
    drive(fast, goal)
    settle(fast)
    assert distance(fast.true_pose(), goal) <= 0.4
    assert turned(fast.true_pose(), goal) <= 0.05
    assert fast.state() == "goal reached"


def test_goals_reached_are_counted_and_waiting_comes_before_the_first_pose():
    with robot(only=("controller",), namespace="/lonely") as one:
        assert one.peer.spin_until(one.state, 5.0, "a status") == "idle"
        one.send_goal(1.0, 2.0, 0.5)
        assert one.state() == "waiting for pose"
        assert not one.commands, "nothing to answer yet"


def test_pace_of_the_scaled_clock(fast):
    """Steps of 0.1 s, five times as many as on the wall clock, by the plant's own count."""
    fast.wait_for_odometry_rate(50.0)
    stamps = [stamp(message) for message in fast.truths]
    assert {after - before for before, after in itertools.pairwise(stamps)} == {100_000_000}


def test_newest_goal_wins(fast):
    fast.send_goal(8.0, 8.0, 0.0)
    settle(fast, 1.0)
    fast.wait_for_state("driving")
    newer = (-1.0, -2.0, -1.0)
    drive(fast, newer)
    settle(fast)
    assert distance(fast.true_pose(), newer) <= 0.4
    assert turned(fast.true_pose(), newer) <= 0.05


def test_cancel_stops_at_once_and_then_leaves_cmd_vel_alone(fast):
    fast.send_goal(6.0, 0.0, 0.0)
    fast.peer.spin_until(lambda: abs(twist(fast.commands[-1])[0]) > 0.3, 5.0, "motion")
    answer = fast.cancel()
    assert (answer.success, answer.message) == (True, "cancelled")
    fast.wait_for_state("idle")
    # What was on its way at the moment of the cancellation may still come.
    fast.peer.spin_for(0.5)
    assert twist(fast.commands[-1]) == (0.0, 0.0)
    zeros = [twist(command) for command in fast.commands[-4:]]
    assert zeros == [(0.0, 0.0)] * 4, "said more than once: one message may be lost"
    count = len(fast.commands)
    settle(fast, 3.0)
    assert len(fast.commands) == count
    assert math.hypot(*planar_speed(fast)) < 1e-9
    again = fast.cancel()
    assert (again.success, again.message) == (False, "there was no goal")
    assert fast.state() == "idle"


def planar_speed(robot):
    truth = robot.truths[-1].twist.twist
    return truth.linear.x, truth.angular.z


def test_hold_goal_decides_whether_a_reached_goal_is_still_controlled(fast):
    drive(fast, (-2.0, 0.0, 0.0))
    count = len(fast.commands)
    settle(fast, 2.0)
    assert len(fast.commands) - count >= 15, "held"
    assert fast.set_parameter("controller", "hold_goal", False).successful
    try:
        drive(fast, (0.5, 1.0, 1.0))
        settle(fast, 1.0)
        assert [twist(command) for command in fast.commands[-3:]] == [(0.0, 0.0)] * 3
        count = len(fast.commands)
        settle(fast, 3.0)
        assert len(fast.commands) == count, "left alone"
        assert fast.state() == "goal reached"
        assert distance(fast.true_pose(), (0.5, 1.0)) <= 0.4
    finally:
        assert fast.set_parameter("controller", "hold_goal", True).successful


def test_publish_when_idle_answers_every_pose_with_zero(fast):
    fast.cancel()
    settle(fast, 1.0)
    assert fast.set_parameter("controller", "publish_when_idle", True).successful
    try:
        fast.peer.spin_for(0.1)
        poses, count = len(fast.poses), len(fast.commands)
        settle(fast, 3.0)
        answers = fast.commands[count:]
        assert len(answers) == pytest.approx(len(fast.poses) - poses, abs=2)
        assert {twist(command) for command in answers} == {(0.0, 0.0)}
    finally:
        fast.set_parameter("controller", "publish_when_idle", False)


def test_a_second_robot_with_stamped_commands_in_its_namespace_does_not_disturb_the_first(fast):
    mine, its = (1.0, 1.0, 0.0), (0.0, 0.0, 0.0)
    plant = {"enable_stamped_cmd_vel": True, "initial_pose.x": -1.5, "initial_pose.y": 0.1, "initial_pose.yaw": 0.0}
    with robot(plant, controller={"enable_stamped_cmd_vel": True}, namespace="/second", stamped=True) as second:
        fast.send_goal(*mine)
        second.send_goal(*its)
        fast.wait_for_state("goal reached", 20.0)
        second.wait_for_state("goal reached", 20.0)
        fast.peer.spin_for(0.3)
        assert distance(fast.true_pose(), mine) <= 0.4
        assert distance(second.true_pose(), its) <= 0.4
        assert turned(second.true_pose(), its) <= 0.05
        # Each command carries the stamp of the pose that it answers.
        assert isinstance(second.commands[-1], TwistStamped)
        assert second.commands[-1].header.frame_id == "base_link"
        answered = [stamp(pose) for pose in second.poses]
        answers = {stamp(one) for one in second.commands if answered[0] <= stamp(one) <= answered[-1]}
        assert len(answers) > 10
        assert answers <= set(answered)
        names = {status.name for array in second.diagnostics for status in array.status}
        assert {"/second/plant", "/second/controller", "/controller"} <= names
        assert {planar(message.pose.pose)[0] for message in second.truths} & {fast.true_pose()[0]} == set()
