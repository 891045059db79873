"""Lock-step: the graph of three processes drives exactly as the closed loop without ROS, however slow a node is."""

import itertools
import signal
from collections import Counter

from lockstep_drive import PERIOD, START, STEPS, assert_same_path, go, repeated, true_path
from robot import lockstep, stamp
from rosgraph_msgs.msg import Clock
from std_srvs.srv import Trigger

GOAL = (0.0, 0.0, 0.0)


PLANT = {
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


def test_same_path_as_the_closed_loop_twice_in_a_row():
    goal = (4.0, -1.0, 2.5)
    with lockstep(PLANT) as robot:
        clocks = robot.peer.subscribe(Clock, "/clock", 1000)
        assert_same_path(go(robot, goal), goal, PLANT)
        times = [message.clock.sec * 10**9 + message.clock.nanosec for message in clocks]
        # A step whose answer was lost is sent again.
        assert {after - before for before, after in itertools.pairwise(times)} <= {0, PERIOD}
        robot.peer.call(Trigger, "plant/reset")
        robot.peer.call(Trigger, "ekf/reset")
        assert_same_path(go(robot, goal), goal, PLANT)


def test_same_path_by_joint_states_and_odometry_filtered():
    with lockstep({"seed": 5}, {"odometry_source": "joint_states"}, {"pose_source": "odometry"}) as robot:
        assert_same_path(go(robot, GOAL), GOAL, {"seed": 5})
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
        # Each repeat of the step sends its truth again.
        last = robot.peer.spin_until(lambda: repeated(robot.truths, 4), what="repeats of the step")
    finally:
        robot.processes[name].send(signal.SIGCONT)
    robot.peer.spin_until(lambda: stamp(robot.truths[-1]) >= last + steps * PERIOD, what="the steps after it")
    return last


def test_nodes_that_slept_longer_than_the_timeout_change_nothing_but_the_count_of_repeats():
    """Their late answers to a step's repeated messages must not put the loop a step behind, nor fuse a fix twice."""
    world = {"seed": 7, "fix_delay": 0.2}
    stamped = {"enable_stamped_cmd_vel": True}
    with lockstep({**world, "lockstep_timeout": 0.5, **stamped}, controller=stamped, stamped=True) as robot:
        robot.send_goal(*GOAL)
        robot.pause(False)
        robot.peer.spin_until(lambda: len(robot.truths) > 20, what="20 steps")
        slept = [put_to_sleep(robot, "controller", 40), put_to_sleep(robot, "ekf", STEPS)]
        robot.pause(True)
        assert int(robot.diagnosis("plant")["steps sent again"]) >= 6
        robot.catch_up()
    path = true_path(robot.truths)
    times = [stamp(message) for message in robot.truths]
    assert times == sorted(times)
    again = [when for when, count in sorted(Counter(times).items()) if count > 1]
    # DDS keeps no order between topics for one who was away: from the first repeated step on a fix may come late.
    assert_same_path(path, GOAL, world, (again[0] - START) // PERIOD, moved=0.0)
    assert_same_path(path, GOAL, world, tolerance=0.3)
    for last, steps in zip(slept, (40, 100), strict=True):
        assert_not_a_step_behind(robot, [last + step * PERIOD for step in range(5, steps)])
    # One command a step, and at most one more for each time that it was sent again.
    assert -3 <= len(robot.commands) - len(set(times)) <= len(times) - len(set(times)) + 3


def test_without_answers_the_plant_reports_it_once_and_keeps_asking():
    plant = {"lockstep_timeout": 0.1, "start_paused": False}
    with lockstep(plant, only=("ekf", "plant")) as robot:
        robot.peer.spin_until(lambda: len(robot.poses) > 5, what="repeated steps")
        assert {stamp(message) for message in robot.poses} == {START}
        assert robot.processes["plant"].output.count("no command on cmd_vel") == 1
        # A controller that comes late takes the loop up.
        robot.start("controller", {"publish_when_idle": True, "reliable_inputs": True})
        robot.peer.spin_until(lambda: robot.truths and stamp(robot.truths[-1]) > START + 20 * PERIOD, what="steps")
