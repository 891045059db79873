"""Detection of contradictory measurements of one motion: twist and pose of the odometry, or gyro and wheels.

Two rates contradict each other if they disagree for most of the last MOTION seconds of motion. Rest does not count: the
robot moves if one of the rates shows a motion.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from diffbot_core.geometry import Pose, wrap_angle
from diffbot_core.kinematics import Twist
from diffbot_core.stamps import S_PER_NS

MOTION = 2.0
"""[s] Length of the memory in motion. A new fault is detected after log(10 / 3) times this time."""
_SHARE = 0.7
"""Share of MOTION above which a disagreement is a contradiction."""
_MIN_RATIO, _MIN_OPPOSED_RATIO = 0.1, 0.3
"""Ratio of the smaller to the larger rate. Below the first bound, the smaller rate does not show the motion. Different
signs only count above the second bound."""
MIN_SPEED, MIN_RATE = 0.05, 0.1
"""[m/s], [rad/s] smallest rates that count as motion"""
_INTERVAL, _MAX_INTERVAL = 0.1, 1.0
"""[s] Shortest time over which poses are differenced, so that the resolution of encoders does not matter, and longest
time between two messages; a longer time is a gap."""
_MAX_CHANGE = 20.0
"""[m/s], [rad/s] A faster change of the pose is a jump, for instance because the driver resets its pose to 0."""


class Agreement(NamedTuple):
    """Times [s] of motion for which two rates agreed or disagreed; their sum is at most MOTION."""

    agreed: float = 0.0
    opposed: float = 0.0
    """the rates had different signs"""
    only_first: float = 0.0
    """only the first rate showed a motion"""
    only_second: float = 0.0
    """only the second rate showed a motion"""
    scaled: float = 0.0
    """both rates showed a motion, but one rate was at least ten times the other"""

    def contradiction(self) -> str:
        """Return the name of the longest disagreement; empty if the rates agreed or there was too little motion."""
        if sum(self) < 0.999 * MOTION or self.agreed > (1.0 - _SHARE) * MOTION:
            return ""
        return max(self._fields[1:], key=lambda name: float(getattr(self, name)))


def with_rates(memory: Agreement, dt: float, first: float, second: float, smallest: float) -> Agreement:
    """Add two measurements of a rate over ``dt`` [s], unless both are below ``smallest``, as at rest."""
    low, high = sorted((abs(first), abs(second)))
    if high < smallest:
        return memory
    if low < _MIN_RATIO * high:
        kind = "scaled" if low >= _MIN_RATIO * smallest else "only_first" if abs(first) == high else "only_second"
    else:
        kind = "opposed" if first * second < 0.0 and low > _MIN_OPPOSED_RATIO * high else "agreed"
    memory = memory._replace(**{kind: getattr(memory, kind) + dt})
    scale = min(MOTION / sum(memory), 1.0)
    return Agreement(*(scale * time for time in memory))


class OdometryCheck:
    """Compares the twists of odometry messages with the changes of their poses."""

    def __init__(self) -> None:
        """Start without a message."""
        self._along = self._turn = Agreement()
        """agreement of the rate of the pose (first) and the twist (second)"""
        self._stamp: int | None = None
        self._start = Pose(0.0, 0.0, 0.0)
        self._time = self._driven = self._turned = 0.0
        """[s], [m], [rad] time since the pose ``_start``, and integrals of the twists since then"""

    def add(self, stamp: int, pose: Pose, twist: Twist) -> None:
        """Add a message: stamp [ns], pose in ``odom``, and mean twist since the previous message."""
        dt = 0.0 if self._stamp is None else (stamp - self._stamp) * S_PER_NS
        self._stamp = stamp
        if not 0.0 < dt <= _MAX_INTERVAL:
            self._restart(pose)
            return
        self._time += dt
        self._driven += twist.v * dt
        self._turned += twist.omega * dt
        if self._time < _INTERVAL:
            return
        start, time = self._start, self._time
        turned = wrap_angle(pose.theta - start.theta)
        middle = start.theta + 0.5 * turned
        along = (pose.x - start.x) * math.cos(middle) + (pose.y - start.y) * math.sin(middle)
        if max(abs(along), abs(turned)) < _MAX_CHANGE * time:
            self._along = with_rates(self._along, time, along / time, self._driven / time, MIN_SPEED)
            self._turn = with_rates(self._turn, time, turned / time, self._turned / time, MIN_RATE)
        self._restart(pose)

    def _restart(self, pose: Pose) -> None:
        self._start, self._time, self._driven, self._turned = pose, 0.0, 0.0, 0.0

    def fault(self) -> str:
        """Return how pose and twist contradict each other, and what to do; empty if they agree."""
        for memory, field, part in (
            (self._along, "twist.linear.x", "position"),
            (self._turn, "twist.angular.z", "orientation"),
        ):
            texts = {
                "only_first": f"{field} stays 0 although the {part} changes: the driver has to fill the twist",
                "only_second": f"the {part} does not change although {field} is not 0: the driver has to fill the pose",
                "opposed": f"{field} and the pose have opposite signs: check that the wheels are not swapped, "
                "and that x points forward and y to the left",
                "scaled": f"{field} and the pose differ by a factor of ten or more: use m, m/s, rad and rad/s",
            }
            if kind := memory.contradiction():
                return texts[kind]
        return ""
