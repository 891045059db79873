"""A robot with false inputs: odometry that stands still, and fixes that contradict the odometry."""

import math
import time

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from filter_input import fix, odometry
from geometry_msgs.msg import PoseWithCovarianceStamped
from graph import PATIENCE
from nav_msgs.msg import Odometry
from repeated import tried
from robot import robot, twist
from std_srvs.srv import Trigger
from witness import LOST_INPUT, PERIOD

FEED_PERIOD = 0.05
FIX_EVERY = 2
CONTRADICTED = 20.0
"""[s] until a robot stands if its fixes contradict its odometry"""
SPEED = {"linear.x.max_velocity": 0.8, "linear.x.max_acceleration": 1.0, "angular.z.max_acceleration": 3.0}
FALSE_FIXES = {
    "fixes turned": lambda x, y, theta: (x, y, theta + math.pi),
    "fixes mirrored": lambda x, y, theta: (x, -y, -theta),
    "fixes swapped": lambda x, y, theta: (y, x, theta),
}
"""The false fix for each true pose."""
FAULTS = ["odometry frozen", "fixes turned"]
FAULTS += [pytest.param(one, marks=pytest.mark.slow) for one in ("fixes frozen", "fixes mirrored", "fixes swapped")]
"""test_drives.py tests the detection of all false fixes with the filter alone."""


def direction(seeded):
    """Return a random heading [rad] with the digits that the status shows."""
    return round(seeded.uniform(-math.pi, math.pi), 2)


def differs(falsify, bearing):
    """Return True if a false fix differs in bearing or heading for a robot that has driven in this direction."""
    x, y, theta = falsify(math.cos(bearing), math.sin(bearing), bearing)
    turns = (math.remainder(one - bearing, 2.0 * math.pi) for one in (math.atan2(y, x), theta))
    return max(map(abs, turns)) > 0.5


class Base:
    """A base that obeys cmd_vel exactly; its odometry and its fixes can be falsified."""

    def __init__(self, running):
        self.running, self.peer = running, running.peer
        self.odom = self.peer.publisher(Odometry, "odom")
        self.fixes = self.peer.publisher(PoseWithCovarianceStamped, "global_pose")
        self.peer.wait_for_subscribers(self.odom, self.fixes)
        self.pose, self.fed, self.number = (0.0, 0.0, 0.3), time.time(), 0
        self.restore()

    def restore(self):
        """Publish true odometry and fixes again."""
        self.frozen = None
        self.falsify = lambda *pose: pose
        self.frozen_fix = None

    def feed(self):
        """Move for the time since the last call, and publish."""
        now = time.time()
        if now - self.fed < FEED_PERIOD:
            return
        v, omega = twist(self.running.commands[-1]) if self.running.commands else (0.0, 0.0)
        x, y, theta = self.pose
        passed, self.fed = now - self.fed, now
        middle = theta + 0.5 * omega * passed
        self.pose = x + v * passed * math.cos(middle), y + v * passed * math.sin(middle), theta + omega * passed
        self.odom.publish(odometry(self.frozen or now, v, omega, self.pose))
        self.number += 1
        if self.number % FIX_EVERY == 0:
            self.fixes.publish(fix(now, *(self.frozen_fix or self.falsify(*self.pose))))

    def until(self, condition, what, timeout=PATIENCE):
        """Feed until a condition holds."""
        self.peer.spin_until(lambda: self.feed() or condition(), timeout, what)

    def begin(self, pose):
        """Stand at a pose with true odometry and fixes."""
        self.restore()
        self.pose = pose
        assert self.peer.call(Trigger, "ekf/reset").success
        count = len(self.running.poses)
        self.until(lambda: len(self.running.poses) > count + 10, "poses again")

    def drive(self, seeded, falsify=None):
        """Drive towards a far goal for a random time, in a direction in which the false fix differs."""
        bearing = direction(seeded)
        while falsify is not None and not differs(falsify, bearing):
            bearing = direction(seeded)
        self.begin((0.0, 0.0, bearing))
        self.running.send_goal(round(60.0 * math.cos(bearing), 2), round(60.0 * math.sin(bearing), 2), bearing)
        self.until(lambda: self.running.state() == "driving" and self.speed() > 0.5, "motion")
        end = time.monotonic() + seeded.uniform(0.0, 1.0)
        self.until(lambda: time.monotonic() > end, "a moment")

    def speed(self):
        """Return |v| of the newest command [m/s]."""
        return abs(twist(self.running.commands[-1])[0]) if self.running.commands else 0.0

    def time_to_stand(self, since):
        """Return the time until the robot stood and its goal had ended [s]."""
        stood = [math.inf]

        def given_up():
            still = twist(self.running.commands[-1]) == (0.0, 0.0)
            stood[0] = min(stood[0], time.monotonic()) if still else math.inf
            return still and self.running.state() == "goal not reached"

        self.until(given_up, "the end of the goal", 3.0 * PATIENCE)
        return stood[0] - since

    def diagnosed(self, text):
        """Wait for an ERROR with this text on /diagnostics, newer than the last clear of the reports."""

        def named():
            reports = (one for array in self.running.diagnostics for one in array.status)
            return any(one.level == DiagnosticStatus.ERROR and text in one.message for one in reports)

        self.until(named, text)


@pytest.fixture(scope="module")
def base():
    with robot(controller={**SPEED, "pose_lost_timeout": 4.0}, only=("robot",)) as running:
        yield Base(running)


@tried(20)
@pytest.mark.parametrize("fault", FAULTS)
def test_false_odometry_or_fixes_stop_the_robot_and_are_named(base, trials, seeded, fault):
    for _ in trials:
        base.drive(seeded, FALSE_FIXES.get(fault))
        base.running.diagnostics.clear()
        if fault == "odometry frozen":
            # The stamp of the last message: a newer stamp would be one more new message.
            base.frozen = base.fed
        elif fault == "fixes frozen":
            base.frozen_fix = base.pose
        else:
            base.falsify = FALSE_FIXES[fault]
        bound = trials.bound(LOST_INPUT if base.frozen else CONTRADICTED)
        assert base.time_to_stand(time.monotonic()) <= bound
        base.diagnosed("odometry stands still" if base.frozen else "poses withheld")


@tried(20, once=0)
def test_a_held_goal_ends_without_motion_if_the_robot_is_found_elsewhere(base, trials, seeded):
    for _ in trials:
        base.begin((0.0, 0.0, direction(seeded)))
        base.running.send_goal(*base.pose)
        base.until(lambda: base.running.state() == "goal reached", "the goal")
        x, y, theta = base.pose
        base.pose = x + seeded.choice([-3.0, 3.0]), y, theta
        # The reset makes the filter start again at the new place.
        assert base.peer.call(Trigger, "ekf/reset").success
        begin = len(base.running.commands)
        base.until(lambda: base.running.state() == "idle", "idle")
        end = time.monotonic() + 10 * PERIOD
        base.until(lambda end=end: time.monotonic() > end, "a second")
        assert {twist(command) for command in base.running.commands[begin:]} <= {(0.0, 0.0)}
