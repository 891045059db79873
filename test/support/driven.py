"""A robot for the tests of the law: a unicycle with dead time and lag, independent of the simulation."""

import math

from diffbot_control.law.law import CONTACT_UNKNOWN, Observation
from diffbot_control.law.switching import SwitchingLaw
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist
from diffbot_core.uncertainty import CERTAIN, Estimate

T_S = 0.1
ORIGIN = Pose(0.0, 0.0, 0.0)
MS = 0.001


def seen(pose, uncertainty=CERTAIN, dt=T_S, period=T_S):
    """Return the observation of a pose."""
    return Observation(Estimate(pose, uncertainty), dt, period, CONTACT_UNKNOWN)


class Robot:
    """A robot that moves along exact arcs, or with dead time or lag in steps of a millisecond."""

    def __init__(self, pose, latency=0.0, lag=0.0):
        self.pose, self.lag = Pose(*pose), lag
        self.queue = [Twist(0.0, 0.0)] * round(latency / MS)
        self.motion = Twist(0.0, 0.0)
        self.turned = 0.0
        """[rad] sum of the angles turned in both directions"""

    def drive(self, command, duration=T_S):
        if not self.queue and not self.lag:
            self._move(command, duration)
            return
        share = 1.0 - math.exp(-MS / self.lag) if self.lag else 1.0
        for _ in range(round(duration / MS)):
            self.queue.append(command)
            acting = self.queue.pop(0)
            self.motion = Twist(*(now + share * (new - now) for now, new in zip(self.motion, acting, strict=True)))
            self._move(self.motion, MS)

    def _move(self, twist, dt):
        (x, y, theta), half = self.pose, 0.5 * twist.omega * dt
        chord = twist.v * dt * (math.sin(half) / half if half else 1.0)
        x, y = x + chord * math.cos(theta + half), y + chord * math.sin(theta + half)
        self.pose = Pose(x, y, math.remainder(theta + 2.0 * half, math.tau))
        self.turned += abs(2.0 * half)


class Run:
    """A robot under a law that drives to the origin, without noise; records poses, commands and reports."""

    def __init__(self, start, config, steps=300, *, law=SwitchingLaw, uncertainty=CERTAIN, memory=None, period=T_S):
        """Drive for a number of steps; all estimates have the same uncertainty."""
        sheet = law.data_sheet(config)
        self.robot = Robot(start, sheet.command_latency, sheet.drive_time_constant)
        self.law, self.config, self.memory = law, config, memory or law.new_memory(config)
        self.uncertainty, self.period = uncertainty, period
        self.poses, self.commands, self.reports = [], [], []
        for _ in range(steps):
            self.advance()

    def advance(self):
        """Drive for one step, and return its command."""
        dt = self.period if self.commands else 0.0
        observation = seen(self.robot.pose, self.uncertainty, dt, self.period)
        self.poses.append(self.robot.pose)
        self.memory, command, report = self.law.step(self.memory, observation, ORIGIN, self.config)
        self.commands.append(command)
        self.reports.append(report)
        self.robot.drive(command, self.period)
        return command

    @property
    def settled_after(self):
        outside = [i for i, p in enumerate(self.poses) if math.hypot(p.x, p.y) > 0.1 or abs(p.theta) > 0.1]
        return self.period * (outside[-1] + 1) if outside else 0.0
