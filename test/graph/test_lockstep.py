"""Lock-step: the graph of three processes drives exactly as the closed loop without ROS, however slow a node is.

A node that does not answer is passed over. Filter and controller take the inputs that are not their default ones; with
those, test/tools/demo/test_demo.py compares the path, and test_robot_node.py in one process.
"""

import itertools
import signal

import pytest
from lockstep_drive import PERIOD, STEPS, assert_same_path, go, take_what_is_under_way
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
    # One each step from the first fix on, which comes 0.3 s late.
    assert int(received["odometry/filtered received"]) >= STEPS - 2
    assert "pose received" not in received


def put_to_sleep(robot, name):
    """Stop a node until the plant has moved on without an answer; return the stamp of the step without one."""
    before = unanswered(robot)
    robot.processes[name].send(signal.SIGSTOP)
    try:
        robot.peer.spin_until(lambda: unanswered(robot) > before + 1, what="steps without an answer")
        robot.catch_up()
        slept_at = stamp(robot.truths[-1])
    finally:
        robot.processes[name].send(signal.SIGCONT)
    return slept_at


def unanswered(robot):
    return int(robot.diagnosis("plant")["steps without an answer"])


def test_a_node_that_sleeps_neither_stops_the_robot_for_ever_nor_puts_it_a_step_behind(robot):
    robot.peer.call(Trigger, "plant/reset")
    robot.peer.call(Trigger, "ekf/reset")
    robot.send_goal(*GOAL)
    robot.catch_up()
    robot.truths.clear()
    robot.commands.clear()
    robot.pause(False)
    robot.peer.spin_until(lambda: len(robot.truths) > 20, what="20 steps")
    for name in ("controller", "ekf"):
        slept_at = put_to_sleep(robot, name)
        robot.peer.spin_until(
            lambda at=slept_at: stamp(robot.truths[-1]) >= at + 30 * PERIOD, what="the steps after it"
        )
    robot.pause(True)
    take_what_is_under_way(robot)
    assert "no answer on cmd_vel: moving on with zero command" in robot.processes["plant"].output
    times = [stamp(message) for message in robot.truths]
    assert times == sorted(set(times)), "each step is sent once"
    # From the answers on, the robot moves as the answer to each pose says, but for the 5 % of each wheel.
    asked = {stamp(command): command.twist for command in robot.commands}
    moved = {stamp(truth): truth.twist.twist for truth in robot.truths}
    for when in times[-20:-1]:
        wanted, found = asked[when], moved[when + PERIOD]
        bound = 0.05 * (abs(wanted.linear.x) + 0.3 * abs(wanted.angular.z)) + 1e-9
        assert abs(found.linear.x - wanted.linear.x) <= bound
