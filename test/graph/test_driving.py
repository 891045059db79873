"""Driving to goals: reaching, cancelling and holding them, at five times the pace of the wall clock."""

import math

import pytest
from robot import SIMULATED, distance, robot, stamp, turned, twist

GOAL = (-1.0, 1.0, math.pi)
STOP = (0.0, 0.0)


@pytest.fixture(scope="module")
def fast():
    plant = {"clock": "scaled", "real_time_factor": 5.0, "seed": 3}
    with robot(plant, SIMULATED, SIMULATED) as running:
        running.peer.spin_until(lambda: running.truths and running.poses, what="the first poses")
        yield running


def drive(robot, goal):
    robot.send_goal(*goal)
    robot.wait_for_state("goal reached", 25.0)


def settle(robot, seconds=2.0):
    """Let simulated seconds pass."""
    robot.catch_up()
    end = stamp(robot.truths[-1]) + seconds * 1e9
    robot.peer.spin_until(lambda: stamp(robot.truths[-1]) >= end, what="simulated time")


def test_a_goal_is_reached_and_held_unless_hold_goal_is_off(fast):
    drive(fast, GOAL)
    count = len(fast.commands)
    settle(fast)
    assert distance(fast.true_pose(), GOAL) <= 0.4
    assert turned(fast.true_pose(), GOAL) <= 0.05
    assert fast.state() == "goal reached"
    assert len(fast.commands) - count >= 15, "held"
    assert fast.set_parameter("controller", "hold_goal", False).successful
    try:
        drive(fast, (0.5, 1.0, 1.0))
        settle(fast)
        assert {twist(command) for command in fast.commands[-3:]} == {STOP}
        count = len(fast.commands)
        settle(fast)
        assert len(fast.commands) == count, "left alone"
        assert distance(fast.true_pose(), (0.5, 1.0)) <= 0.4
    finally:
        assert fast.set_parameter("controller", "hold_goal", True).successful


def test_cancel_stops_at_once_and_then_leaves_cmd_vel_alone(fast):
    fast.send_goal(6.0, 0.0, 0.0)
    fast.peer.spin_until(lambda: abs(twist(fast.commands[-1])[0]) > 0.3, what="motion")
    answer = fast.cancel()
    assert (answer.success, answer.message) == (True, "cancelled")
    fast.wait_for_state("idle")
    settle(fast)
    # Repeated, since one message may be lost.
    assert {twist(command) for command in fast.commands[-4:]} == {STOP}
    count = len(fast.commands)
    settle(fast)
    assert len(fast.commands) == count
    truth = fast.truths[-1].twist.twist
    assert math.hypot(truth.linear.x, truth.angular.z) < 1e-9
    again = fast.cancel()
    assert (again.success, again.message) == (False, "there was no goal")


def test_publish_when_idle_answers_every_pose_with_zero(fast):
    fast.cancel()
    settle(fast)
    assert fast.set_parameter("controller", "publish_when_idle", True).successful
    try:
        fast.catch_up()
        poses, count = len(fast.poses), len(fast.commands)
        settle(fast, 3.0)
        answers = fast.commands[count:]
        assert len(answers) == pytest.approx(len(fast.poses) - poses, abs=3)
        assert {twist(command) for command in answers} == {STOP}
    finally:
        fast.set_parameter("controller", "publish_when_idle", False)
