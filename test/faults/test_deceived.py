"""A robot with false inputs: odometry that stands still, and fixes that contradict the odometry."""

import math
import time
from functools import partial

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from filter_input import fix, odometry
from geometry_msgs.msg import PoseWithCovarianceStamped
from graph import PATIENCE
from nav_msgs.msg import Odometry
from repeated import tried
from robot import robot, twist
from std_srvs.srv import Trigger
from witness import LOST_INPUT

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


class Base:
    """A base that obeys cmd_vel exactly; its odometry and its fixes can be falsified."""

    def __init__(self, running):
        self.running, self.peer = running, running.peer
        self.odom = self.peer.publisher(Odometry, "odom")
        self.fixes = self.peer.publisher(PoseWithCovarianceStamped, "global_pose")
        self.peer.wait_for_subscribers(self.odom, self.fixes)
        self.fed, self.number = time.time(), 0

    def restore(self, pose):
        """Stand at a pose with true odometry and fixes."""
        self.pose, self.frozen, self.falsify = pose, None, lambda *pose: pose

    def command(self):
        return twist(self.running.commands[-1]) if self.running.commands else (0.0, 0.0)

    def feed(self):
        """Move for the time since the last call, and publish."""
        now = time.time()
        if now - self.fed < FEED_PERIOD:
            return
        v, omega = self.command()
        x, y, theta = self.pose
        passed, self.fed = now - self.fed, now
        middle = theta + 0.5 * omega * passed
        self.pose = x + v * passed * math.cos(middle), y + v * passed * math.sin(middle), theta + omega * passed
        self.odom.publish(odometry(self.frozen or now, v, omega, self.pose))
        self.number += 1
        if self.number % FIX_EVERY == 0:
            self.fixes.publish(fix(now, *self.falsify(*self.pose)))

    def until(self, condition, what, timeout=PATIENCE):
        self.peer.spin_until(lambda: self.feed() or condition(), timeout, what)

    def drive(self, seeded):
        """Drive towards a far goal for a random time, in a direction in which each false fix differs by 0.5 rad."""
        bearing = seeded.choice((-1, 1)) * round(seeded.uniform(0.3, 0.5), 2)  # the digits that the status shows
        self.restore((0.0, 0.0, bearing))
        assert self.peer.call(Trigger, "ekf/reset").success
        count = len(self.running.poses)
        self.until(lambda: len(self.running.poses) > count + 10, "poses again")
        self.running.send_goal(round(60.0 * math.cos(bearing), 2), round(60.0 * math.sin(bearing), 2), bearing)
        self.until(lambda: self.running.state() == "driving" and self.command()[0] > 0.5, "motion")
        end = time.monotonic() + seeded.uniform(0.0, 1.0)
        self.until(lambda: time.monotonic() > end, "a moment")

    def time_to_stand(self, since):
        """Return the time until the robot stood and its goal had ended [s]."""
        stood = [math.inf]

        def given_up():
            still = self.command() == (0.0, 0.0)
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
        base.drive(seeded)
        base.running.diagnostics.clear()
        if fault == "odometry frozen":
            # The stamp of the last message: a newer stamp would be one more new message.
            base.frozen = base.fed
        else:
            base.falsify = FALSE_FIXES.get(fault) or partial(lambda pose, *_: pose, base.pose)
        bound = trials.bound(LOST_INPUT if base.frozen else CONTRADICTED)
        assert base.time_to_stand(time.monotonic()) <= bound
        base.diagnosed("odometry stands still" if base.frozen else "poses withheld")
