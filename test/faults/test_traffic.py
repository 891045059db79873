"""A network that loses, delays, repeats and reorders messages."""

import heapq
import itertools
import math
import random
import time

from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from rclpy.qos import QoSProfile, ReliabilityPolicy
from repeated import tried
from robot import distance
from witness import NEAR

LOSS, REPEATED = 0.2, 0.05
DELAY, JITTER = 0.2, 0.1
"""[s] Each message is delayed by DELAY and up to JITTER more, which changes the order."""
BEST_EFFORT = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)
LATE = {
    "command_latency": DELAY + JITTER / 2,
    "linear.x.max_velocity": 1.3,
    "angular.z.max_velocity": 2.6,
    "linear.x.max_acceleration": "inf",
    "angular.z.max_acceleration": "inf",
}
GOAL_TIMEOUT = 120.0


class BadNetwork:
    """Loses, delays, repeats and reorders messages, while the test's node handles its callbacks."""

    def __init__(self, node):
        self._node, self._random = node, random.Random(1)
        self._waiting, self._count = [], itertools.count()
        node.create_timer(0.005, self._send)

    def relay(self, kind, source, target):
        """Pass a topic on under another name."""
        publisher = self._node.create_publisher(kind, target, BEST_EFFORT)
        self._node.create_subscription(kind, source, lambda data: self._take(publisher, data), 100, raw=True)

    def _take(self, publisher, data):
        if self._random.random() < LOSS:
            return
        for _ in range(2 if self._random.random() < REPEATED else 1):
            due = time.monotonic() + DELAY + self._random.uniform(0.0, JITTER)
            heapq.heappush(self._waiting, (due, next(self._count), publisher, data))

    def _send(self):
        while self._waiting and self._waiting[0][0] <= time.monotonic():
            _, _, publisher, data = heapq.heappop(self._waiting)
            publisher.publish(data)


@tried(20, once=0)
def test_goals_are_reached_over_a_bad_network(observed, trials, seeded):
    options = {"only": ("robot", "plant"), "joined": True}
    options["arguments"] = ("-r", "ekf:odom:=relayed/odom", "-r", "ekf:global_pose:=relayed/fix")
    with observed(NEAR, controller=LATE, **options) as witness:
        robot, place = witness.robot, (-4.0, 0.2)
        network = BadNetwork(witness.peer.node)
        network.relay(Odometry, "odom", "relayed/odom")
        network.relay(PoseWithCovarianceStamped, "global_pose", "relayed/fix")
        for _ in trials:
            angle = seeded.uniform(-math.pi, math.pi)
            place = (place[0] + math.cos(angle), place[1] + math.sin(angle))
            # The status shows few digits.
            goal = tuple(round(number, 2) for number in (*place, seeded.uniform(-math.pi, math.pi)))
            robot.send_goal(*goal, tries=5)
            robot.wait_for_state("goal reached", GOAL_TIMEOUT)
            assert distance(robot.true_pose(), goal) <= 0.4
