"""A driving robot whose clock fails: it stops in real time, the cause is named, and it drives on afterwards."""

import time

import graph
import one_process
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, Twist
from robot import initialpose, pose_stamped
from rosgraph_msgs.msg import Clock

from diffbot_control.controller_node import ControllerNode

TIMEOUT = 0.4


@pytest.fixture
def nodes():
    with one_process.nodes() as running:
        yield running


class Drive:
    """A controller on simulated time that drives by clock and poses of the test."""

    def __init__(self, nodes, **parameters):
        self.peer = peer = nodes.peer
        self.commands = peer.subscribe(Twist, "cmd_vel", 100)
        self.reports = peer.subscribe(DiagnosticArray, "/diagnostics", 100)
        parameters = {"use_sim_time": True, "pose_timeout": TIMEOUT, **parameters}
        self.node = nodes.add(ControllerNode, parameters)
        self.clocks, self.poses = peer.publisher(Clock, "/clock"), peer.publisher(PoseWithCovarianceStamped, "pose")
        goals = peer.publisher(PoseStamped, "goal_pose")
        peer.wait_for_subscribers(self.clocks, self.poses, goals)
        peer.wait_for_publishers("cmd_vel")
        self.time = 1000.0
        self.tell_time()
        goals.publish(pose_stamped(50.0, 0.0, 0.0))
        peer.spin_until(lambda: self.node.supervisor.goal is not None, 5.0, "the goal")

    def tell_time(self):
        message = Clock()
        message.clock.sec, message.clock.nanosec = divmod(round(self.time * 1e9), 10**9)
        self.clocks.publish(message)

    def step(self, clock=True, pose=True):
        """Let a tenth of a second pass."""
        self.time += 0.1
        if clock:
            self.tell_time()
        if pose:
            message = initialpose(0.0, 0.0, 0.0)
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(round(self.time * 1e9), 10**9)
            self.poses.publish(message)
        self.peer.spin_for(0.05)

    def until(self, moves, clock=True, pose=True):
        """Step until the newest command moves the robot, or stops it; return the time [s] that it took."""
        begin = time.monotonic()
        self.commands.clear()
        while not (self.commands and (self.commands[-1] != Twist()) == moves):
            assert time.monotonic() - begin < graph.PATIENCE, f"moves: {moves}"
            self.step(clock, pose)
        return time.monotonic() - begin

    def wait_for_report(self, text):
        self.reports.clear()
        self.peer.spin_until(
            lambda: [one for array in self.reports for one in array.status if text in one.message], 5.0, text
        )


def test_clock_that_stands_still_stops_the_robot_whether_poses_come_or_not(nodes):
    drive = Drive(nodes)
    for pose in (False, True):
        drive.until(moves=True)
        assert TIMEOUT / 2 < drive.until(moves=False, clock=False, pose=pose) < 10 * TIMEOUT
        assert drive.node.supervisor.state == "stale pose"
        drive.wait_for_report("time on /clock stands still")
    drive.until(moves=True)


def test_missing_poses_stop_the_robot_in_real_time_though_simulated_time_is_slow(nodes):
    drive = Drive(nodes)
    drive.until(moves=True)
    begin = time.monotonic()
    drive.commands.clear()
    while not drive.commands:
        assert time.monotonic() - begin < 10 * TIMEOUT
        drive.time += 0.001
        drive.tell_time()
        drive.peer.spin_for(0.05)
    assert drive.commands[-1] == Twist()


def test_factor_lets_a_slow_simulation_drive_on(nodes):
    drive = Drive(nodes, real_timeout_factor=20.0)
    drive.until(moves=True)
    drive.commands.clear()
    drive.peer.spin_for(2 * TIMEOUT)
    assert not drive.commands
    drive.step()
    drive.peer.spin_until(lambda: drive.commands, 5.0, "an answer")
    assert Twist() not in drive.commands


def test_jump_back_stops_the_robot_for_a_second_and_is_named(nodes):
    drive = Drive(nodes)
    drive.until(moves=True)
    drive.time -= 500.0
    assert drive.until(moves=False) < 3 * TIMEOUT
    drive.wait_for_report("time on /clock jumped back")
    drive.until(moves=True)


def test_second_publisher_of_clock_stops_the_robot_and_is_named(nodes):
    drive = Drive(nodes)
    drive.until(moves=True)
    with graph.peer("intruder") as intruder:
        other = intruder.publisher(Clock, "/clock")
        intruder.wait_for_subscribers(other)
        drive.until(moves=False)
        drive.wait_for_report("2 publishers of /clock, only one may own time")
        assert drive.node.supervisor.state == "stale pose"
    drive.until(moves=True)
