"""Drives with a lossy odometry: plant, relay, filter and controller in one process."""

import math

import one_process
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from lossy_relay import LossyRelay
from nav_msgs.msg import Odometry
from robot import planar, pose_stamped
from rosgraph_msgs.msg import Clock

from diffbot_control.controller_node import ControllerNode
from diffbot_control.ekf_node import EkfNode
from diffbot_sim.plant_node import PlantNode

LOSS = 0.2
RADIUS = 3.0
"""[m] of the circle on which the goals are."""


def goals(count):
    """Return goals around the start, each with another heading."""
    angles = [2.4 * number for number in range(count)]
    return [(RADIUS * math.cos(one), RADIUS * math.sin(one), math.remainder(1.7 * one, 2 * math.pi)) for one in angles]


class Drive:
    """A robot whose odometry and fixes come best effort, a fifth of them lost, in steps that the test sets off.

    The plant follows a clock that is sent here once the nodes have answered the step before: however busy the machine
    is, the drive is nearly the same.
    """

    def __init__(self, nodes, seed=1):
        """Create the nodes."""
        self.peer = peer = nodes.peer
        self.odometry = LossyRelay(peer.node, Odometry, "odom", "lossy/odom", LOSS, seed)
        self.fixes = LossyRelay(
            peer.node, PoseWithCovarianceStamped, "global_pose", "lossy/global_pose", LOSS, seed + 1
        )
        simulated = {"use_sim_time": True}
        self.ekf = nodes.add(EkfNode, simulated, ("-r", "odom:=lossy/odom", "-r", "global_pose:=lossy/global_pose"))
        self.controller = nodes.add(ControllerNode, simulated)
        nodes.add(PlantNode, {"clock": "scaled", "publish_clock": False, "seed": seed, **simulated})
        self.truths = peer.subscribe(Odometry, "ground_truth")
        self._clocks = peer.publisher(Clock, "/clock")
        self._goals = peer.publisher(PoseStamped, "goal_pose")
        self._time = 1000 * 10**9
        peer.wait_for_subscribers(self._clocks, count=4, timeout=30.0)
        peer.wait_for_subscribers(self._goals, timeout=30.0)

    def step(self):
        """Let a tenth of a second pass."""
        self._time += 10**8
        clock = Clock()
        clock.clock.sec, clock.clock.nanosec = divmod(self._time, 10**9)
        sent, passed, poses = self._steps(), self.odometry.passed, self.ekf.health.sent["pose"]
        handled, answered = self._handled(), self.controller.health.accepted["pose"]
        self._clocks.publish(clock)
        self._wait(lambda: self._steps() > sent)
        if self.odometry.passed > passed:
            self._wait(lambda: self._handled() > handled)
        if self.ekf.health.sent["pose"] > poses:
            self._wait(lambda: self.controller.health.accepted["pose"] > answered)

    def go(self, goal, max_steps=1200):
        """Drive to a goal; return the true pose when it is reached, None if it is not."""
        reached = self.controller.supervisor.goals_reached
        self._goals.publish(pose_stamped(*goal))
        for _ in range(max_steps):
            self.step()
            if self.controller.supervisor.goals_reached > reached:
                return planar(self.truths[-1].pose.pose)
        return None

    def _steps(self):
        return self.odometry.passed + self.odometry.lost

    def _handled(self):
        health = self.ekf.health
        return health.accepted["odom"] + sum(count for (topic, _), count in health.dropped.items() if topic == "odom")

    def _wait(self, condition):
        """Wait for what may be lost for good: messages come best effort."""
        self.peer.comes_true(condition, 2.0)


def drive(count, on_goal=lambda end: None):
    """Drive to ``count`` goals one after the other; return the true poses at the ends, and the drive."""
    with one_process.nodes() as nodes:
        running = Drive(nodes)
        ends = []
        for goal in goals(count):
            ends.append(running.go(goal))
            on_goal(ends[-1])
        return ends, running
