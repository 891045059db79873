"""A bad network, and a flood of goals."""

import heapq
import itertools
import math
import random
import re
import sys
import time

import goal_flood
import graph
from geometry_msgs.msg import PoseWithCovarianceStamped, Twist
from nav_msgs.msg import Odometry
from rclpy.qos import QoSProfile, ReliabilityPolicy
from repeated import tried
from robot import DEEP, ON_TRUTH, TRUE_POSES, distance
from witness import FAR, NEAR

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
FLOOD_RATE, FLOOD_TIME, FLOODS = 1000.0, 5.0, 3
"""[1/s] goals, [s] of each flood and of each pause, and number of floods"""
MAX_RATIO = 1.5
"""99 % of the control periods during floods, over 99 % of the control periods in pauses"""


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


def p99(gaps):
    """Return the 99th percentile [s]."""
    return sorted(gaps)[math.ceil(0.99 * len(gaps)) - 1]


def control_periods(sent, output, kind):
    """Return the periods [s] of commands, sent at ``sent`` [ns], within the intervals of a kind in the output."""
    intervals = [tuple(map(int, words)) for words in re.findall(rf"{kind} (\d+) (\d+)", output)]
    return [
        (after - before) * 1e-9
        for before, after in itertools.pairwise(sent)
        if any(begin <= before and after <= end for begin, end in intervals)
    ]


@tried(4, once=0)
def test_a_flood_of_goals_does_not_change_the_control_period(observed, trials):
    """Floods and pauses alternate, so that other load of the machine meets both alike."""
    command = (sys.executable, goal_flood.__file__, *map(str, (FLOOD_RATE, FLOOD_TIME, FLOODS, FAR[0])))
    options = {"only": ("controller", "plant"), "arguments": {"controller": TRUE_POSES}}
    with observed(NEAR, controller=ON_TRUTH, **options) as witness:
        sent = []
        witness.peer.node.create_subscription(
            Twist, "cmd_vel", lambda _, info: sent.append(info["source_timestamp"]), DEEP
        )
        for _ in trials:
            witness.drive()
            with graph.process(*command) as flood:
                witness.peer.spin_until(lambda flood=flood: flood.popen.poll() is not None, 120.0, "the flood's end")
                quiet, loaded = (control_periods(sent, flood.output, kind) for kind in ("pause", "flood"))
                goals = sum(map(int, re.findall(r"flood \d+ \d+ (\d+)", flood.output)))
            assert min(len(quiet), len(loaded)) >= 5 * FLOOD_TIME * FLOODS, "the robot drives"
            assert goals >= 0.9 * FLOOD_RATE * FLOOD_TIME * FLOODS
            assert p99(loaded) / p99(quiet) <= trials.bound(MAX_RATIO)
