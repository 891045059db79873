"""Lock-step: the graph of three processes drives exactly as the closed loop without ROS, however slow a node is."""

import itertools
import signal
from collections import Counter

import pytest
from geometry_msgs.msg import PoseWithCovarianceStamped
from lockstep_drive import PERIOD, START, STEPS, assert_same_path, go, repeated, true_path
from robot import initialpose, lockstep, planar, stamp
from rosgraph_msgs.msg import Clock
from std_srvs.srv import Trigger


def test_same_path_as_the_closed_loop_twice_in_a_row():
    goal = (0.0, 0.0, 0.0)
    with lockstep({"seed": 5}) as robot:
        clocks = robot.peer.subscribe(Clock, "/clock", 1000)
        assert_same_path(go(robot, goal), goal, {"seed": 5})
        times = [message.clock.sec * 10**9 + message.clock.nanosec for message in clocks]
        # A step whose answer was lost is sent again.
        assert {after - before for before, after in itertools.pairwise(times)} <= {0, PERIOD}
        robot.peer.call(Trigger, "plant/reset")
        robot.peer.call(Trigger, "ekf/reset")
        assert_same_path(go(robot, goal), goal, {"seed": 5})


def test_same_path_with_late_lost_and_wrong_fixes_and_a_compass():
    plant = {
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
    goal = (4.0, -1.0, 2.5)
    with lockstep(plant) as robot:
        assert_same_path(go(robot, goal), goal, plant)


def test_a_filter_that_hears_joint_states_instead_of_odom_goes_the_same_way():
    goal = (0.0, 0.0, 0.0)
    with lockstep({"seed": 6}, ekf={"odometry_source": "joint_states"}) as robot:
        assert_same_path(go(robot, goal), goal, {"seed": 6})


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


@pytest.mark.parametrize("sleeper", ["ekf", "controller"])
def test_a_node_that_slept_longer_than_the_timeout_changes_nothing_but_the_count_of_repeats(sleeper):
    """Its late answers to a step's repeated messages must not put the loop a step behind, nor fuse a fix twice."""
    goal, world = (0.0, 0.0, 0.0), {"seed": 7, "fix_delay": 0.2}
    stamped = {"enable_stamped_cmd_vel": True}
    with lockstep({**world, "lockstep_timeout": 0.5, **stamped}, controller=stamped, stamped=True) as robot:
        robot.send_goal(*goal)
        robot.pause(False)
        robot.peer.spin_until(lambda: len(robot.truths) > 20, 10.0, "20 steps")
        robot.processes[sleeper].send(signal.SIGSTOP)
        try:
            # Each repeat of the step sends its truth again.
            last = robot.peer.spin_until(lambda: repeated(robot.truths, 4), 10.0, "repeats of the step")
        finally:
            robot.processes[sleeper].send(signal.SIGCONT)
        robot.peer.spin_until(lambda: stamp(robot.truths[-1]) >= last + STEPS * PERIOD, 20.0, "the steps after it")
        robot.pause(True)
        assert int(robot.diagnosis("plant")["steps sent again"]) >= 3
    path = true_path(robot.truths)
    times = [stamp(message) for message in robot.truths]
    assert times == sorted(times)
    again = [when for when, count in sorted(Counter(times).items()) if count > 1]
    # DDS keeps no order between topics for one who was away: from the first repeated step on a fix may come late.
    assert_same_path(path, goal, world, (again[0] - START) // PERIOD, moved=0.0)
    assert_same_path(path, goal, world, tolerance=0.3)
    assert_not_a_step_behind(robot, [last + step * PERIOD for step in range(5, 100)])
    # Once awake it needs each step once; on a busy machine a few may be answered late.
    assert sum(when > last for when in again) <= 5
    # One command a step, and at most one more for each time that it was sent again.
    assert -3 <= len(robot.commands) - len(set(times)) <= len(times) - len(set(times)) + 3


def test_without_answers_the_plant_says_so_once_and_keeps_asking():
    plant = {"lockstep_timeout": 0.1, "start_paused": False}
    with lockstep(plant, only=("ekf", "plant")) as robot:
        robot.peer.spin_until(lambda: len(robot.poses) > 5, 10.0, "repeated steps")
        assert {stamp(message) for message in robot.poses} == {START}
        assert robot.processes["plant"].output.count("no command on cmd_vel") == 1
        # A controller that comes late takes the loop up.
        robot.start("controller", {"publish_when_idle": True, "reliable_inputs": True})
        robot.peer.spin_until(lambda: robot.truths and stamp(robot.truths[-1]) > START + 20 * PERIOD, 10.0, "steps")


def test_without_any_fix_the_plant_says_so_and_goes_on_with_an_initialpose():
    start = (1.0, 2.0, -2.0)
    plant = dict(zip(("initial_pose.x", "initial_pose.y", "initial_pose.yaw"), start, strict=True))
    with lockstep({**plant, "fix_dropout": 1.0, "lockstep_timeout": 0.2}) as robot:
        given = robot.peer.publisher(PoseWithCovarianceStamped, "initialpose")
        robot.peer.wait_for_subscribers(given)
        robot.pause(False)
        robot.processes["plant"].wait_for_output("no fix in the first 1000 steps", 30.0)
        first = START + 1000 * PERIOD
        robot.peer.spin_until(
            lambda: [stamp(one) for one in robot.truths].count(first) > 2, 10.0, "repeats of its step"
        )
        assert not robot.poses
        assert {planar(message.pose.pose) for message in robot.truths} == {planar(robot.truths[0].pose.pose)}
        given.publish(initialpose(*start))
        robot.peer.spin_until(lambda: stamp(robot.truths[-1]) > first + 20 * PERIOD, 10.0, "steps")
        assert stamp(robot.poses[0]) == first
        output = robot.processes["plant"].output
    assert output.count("no fix in the first 1000 steps") == 1
