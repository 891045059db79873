"""A driving robot whose clock or poses fail in simulated time: it stops in real time, and drives on afterwards.

Clocks that jump or have two publishers: test/faults/test_clock.py.
"""

import one_process
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Twist
from robot import initialpose, pose_stamped
from rosgraph_msgs.msg import Clock

from diffbot_control.controller_node import ControllerNode

TIMEOUT = 0.4


class Drive(one_process.Fed):
    """A controller on simulated time that drives by clock and poses of the test."""

    def __init__(self, nodes, **parameters):
        super().__init__(nodes, ControllerNode, {"use_sim_time": True, "pose_timeout": TIMEOUT, **parameters})
        self.commands = self.peer.subscribe(Twist, "cmd_vel", 100)
        self.reports = self.peer.subscribe(DiagnosticArray, "/diagnostics", 100)
        self.clocks = self.peer.publisher(Clock, "/clock")
        self.peer.wait_for_subscribers(self.clocks)
        self.time = 1000.0
        self.step(pose=False)
        self.send("goal_pose", pose_stamped(50.0, 0.0, 0.0))

    def step(self, clock=True, pose=True, dt=0.1):
        """Let ``dt`` [s] of simulated time pass."""
        self.time += dt
        sec, nanosec = divmod(round(self.time * 1e9), 10**9)
        if clock:
            message = Clock()
            message.clock.sec, message.clock.nanosec = sec, nanosec
            self.clocks.publish(message)
        if pose:
            message = initialpose(0.0, 0.0, 0.0)
            message.header.stamp.sec, message.header.stamp.nanosec = sec, nanosec
            self.send("pose", message)
        self.peer.spin_for(0.02)

    def until(self, moves, **options):
        """Step until a command moves the robot, or stops it."""
        self.commands.clear()

        def commanded():
            self.step(**options)
            return self.commands and (self.commands[-1] != Twist()) == moves

        self.peer.spin_until(commanded, what=f"moves: {moves}")


@pytest.fixture
def nodes():
    with one_process.nodes() as running:
        yield running


def test_missing_poses_stop_the_robot_in_real_time_though_simulated_time_is_slow(nodes):
    drive = Drive(nodes)
    drive.until(moves=True)
    begin = drive.time
    drive.until(moves=False, pose=False, dt=1e-6)
    assert drive.time - begin < 0.5 * TIMEOUT


def test_factor_lets_a_slow_simulation_drive_on(nodes):
    drive = Drive(nodes, real_timeout_factor=1e3)
    drive.until(moves=True)
    drive.peer.spin_for(0.1)
    drive.commands.clear()
    drive.peer.spin_for(2 * TIMEOUT)
    assert not drive.commands
    drive.until(moves=True)
    assert Twist() not in drive.commands
