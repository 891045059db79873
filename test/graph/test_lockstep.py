"""Lock-step: three processes drive exactly as the closed loop without ROS, however slow a node is.

Filter and controller use joint_states and odometry/filtered here; test_robot_node.py compares the path with the default
inputs.
"""

import itertools
import signal

import pytest
from lockstep_drive import PERIOD, STEPS, assert_same_path, go, receive_all
from robot import lockstep, stamp
from rosgraph_msgs.msg import Clock
from std_srvs.srv import Trigger

GOAL = (4.0, -1.0, 2.5)
WORLD = {
    "seed": 11,
    "run": 3,
    "fix_delay": 0.3,
    "heading_rate": 5.0,
    "fix_dropout": 0.3,
    "fix_outlier": 0.1,
    "initial_pose.x": 1.0,
    "initial_pose.y": 2.0,
    "initial_pose.yaw": -2.0,
}
"""Late, lost and wrong fixes, and a compass."""


@pytest.fixture(scope="module")
def robot():
    odometry = {"odometry_source": "joint_states"}, {"pose_source": "odometry"}
    with lockstep(WORLD, *odometry) as running:
        yield running


def test_same_path_as_the_closed_loop(robot):
    clocks = robot.peer.subscribe(Clock, "/clock", 1000)
    assert_same_path(go(robot, GOAL), GOAL, WORLD)
    times = [message.clock.sec * 10**9 + message.clock.nanosec for message in clocks]
    assert {after - before for before, after in itertools.pairwise(times)} == {PERIOD}
    received = robot.diagnosis("controller")
    # One message each step, from the first fix on, which is 0.3 s late.
    assert int(received["odometry/filtered received"]) >= STEPS - 2
    assert "pose received" not in received


def test_after_a_node_was_stopped_the_robot_drives_on_by_the_answer_to_each_step(robot):
    robot.peer.call(Trigger, "plant/reset")
    robot.peer.call(Trigger, "ekf/reset")
    robot.send_goal(*GOAL)
    robot.catch_up()
    robot.truths.clear()
    robot.commands.clear()
    robot.pause(False)
    robot.peer.spin_until(lambda: len(robot.truths) > 20, what="20 steps")
    robot.processes["ekf"].send(signal.SIGSTOP)
    robot.processes["plant"].wait_for_output("no answer on cmd_vel: moving on with zero command")
    robot.processes["ekf"].send(signal.SIGCONT)
    robot.catch_up()
    count = len(robot.truths)
    robot.peer.spin_until(lambda: len(robot.truths) >= count + 30, what="the steps after it")
    robot.pause(True)
    receive_all(robot)
    assert int(robot.diagnosis("plant")["steps without an answer"]) > 0
    times = [stamp(message) for message in robot.truths]
    assert times == sorted(set(times)), "each step is sent once"
    # Again the robot moves by the command that answers each pose, with an error of up to 5 % of each wheel.
    asked = {stamp(command): command.twist for command in robot.commands}
    moved = {stamp(truth): truth.twist.twist for truth in robot.truths}
    for when in times[-20:-1]:
        wanted, found = asked[when], moved[when + PERIOD]
        bound = 0.05 * (abs(wanted.linear.x) + 0.3 * abs(wanted.angular.z)) + 1e-9
        assert abs(found.linear.x - wanted.linear.x) <= bound
