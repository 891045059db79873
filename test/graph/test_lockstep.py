"""Lock-step: the graph of three processes drives exactly as the closed loop without ROS, however slow a node is.

Filter and controller take the inputs that are not their default ones; with those, test/tools/demo/test_demo.py
compares the path, and test_robot_node.py in one process.
"""

import itertools
import signal
from collections import Counter

import pytest
from lockstep_drive import PERIOD, STEPS, assert_same_path, go, repeated, true_path
from robot import lockstep, stamp
from rosgraph_msgs.msg import Clock
from std_srvs.srv import Trigger

GOAL = (4.0, -1.0, 2.5)
STAMPED = {"enable_stamped_cmd_vel": True}
WORLD = {
    "seed": 11,
    "run": 3,
    "fix_delay": 0.3,
    "heading_rate": 5.0,
    "heading_delay": 0.1,
    "fix_dropout": 0.3,
    "fix_outlier": 0.1,
    "initial_pose.x": 1.0,
    "initial_pose.y": 2.0,
    "initial_pose.yaw": -2.0,
}
"""Late, lost and wrong fixes, and a compass."""


@pytest.fixture(scope="module")
def robot():
    odometry = {"odometry_source": "joint_states"}, {"pose_source": "odometry", **STAMPED}
    with lockstep({**WORLD, **STAMPED}, *odometry, stamped=True) as running:
        yield running


def test_same_path_as_the_closed_loop(robot):
    clocks = robot.peer.subscribe(Clock, "/clock", 1000)
    assert_same_path(go(robot, GOAL), GOAL, WORLD)
    times = [message.clock.sec * 10**9 + message.clock.nanosec for message in clocks]
    # A step whose answer was lost is sent again.
    assert {after - before for before, after in itertools.pairwise(times)} <= {0, PERIOD}
    received = robot.diagnosis("controller")
    assert int(received["odometry/filtered received"]) >= STEPS
    assert "pose received" not in received


def assert_not_a_step_behind(robot, stamps):
    """The robot moves as the answer to each step's pose says, but for the 5 % of each wheel."""
    asked = {stamp(command): command.twist for command in robot.commands}
    moved = {stamp(truth): truth.twist.twist for truth in robot.truths}
    wrong = 0
    for when in stamps:
        wanted, found = asked[when], moved[when + PERIOD]
        bound = 0.05 * (abs(wanted.linear.x) + 0.3 * abs(wanted.angular.z)) + 1e-9
        wrong += abs(found.linear.x - wanted.linear.x) > bound
    assert wrong == 0


def put_to_sleep(robot, name, steps):
    """Stop a node until its step is sent again, and let some steps pass after it; return the stamp of that step."""
    robot.processes[name].send(signal.SIGSTOP)
    try:
        count = len(robot.truths)
        # Each repeat of the step sends its truth again.
        last = robot.peer.spin_until(lambda: repeated(robot.truths[count:], 3), what="repeats of the step")
    finally:
        robot.processes[name].send(signal.SIGCONT)
    robot.peer.spin_until(lambda: stamp(robot.truths[-1]) >= last + steps * PERIOD, what="the steps after it")
    return last


def test_after_a_reset_nodes_that_slept_longer_than_the_timeout_change_nothing_but_the_count_of_repeats(robot):
    """Their late answers to a step's repeated messages must not put the loop a step behind, nor fuse a fix twice."""
    robot.peer.call(Trigger, "plant/reset")
    robot.peer.call(Trigger, "ekf/reset")
    robot.send_goal(*GOAL)
    before = int(robot.diagnosis("plant").get("steps sent again", 0))
    robot.catch_up()
    robot.truths.clear()
    robot.commands.clear()
    robot.pause(False)
    robot.peer.spin_until(lambda: len(robot.truths) > 20, what="20 steps")
    start = stamp(robot.truths[0])
    slept = [put_to_sleep(robot, "controller", 40), put_to_sleep(robot, "ekf", STEPS)]
    robot.pause(True)
    assert int(robot.diagnosis("plant")["steps sent again"]) >= before + 4
    robot.catch_up()
    path = true_path(robot.truths, start)
    times = [stamp(message) for message in robot.truths]
    assert times == sorted(times)
    again = [when for when, count in sorted(Counter(times).items()) if count > 1]
    # DDS keeps no order between topics for one who was away: from the first repeated step on a fix may come late.
    assert_same_path(path, GOAL, WORLD, (again[0] - start) // PERIOD, moved=0.0)
    assert_same_path(path, GOAL, WORLD, tolerance=0.3)
    for last, steps in zip(slept, (40, 100), strict=True):
        assert_not_a_step_behind(robot, [last + step * PERIOD for step in range(5, steps)])
    # One command a step, and at most one more for each time that it was sent again.
    assert -3 <= len(robot.commands) - len(set(times)) <= len(times) - len(set(times)) + 3
