"""Watch over /clock: two sources of simulated time, or none, are reported in words.

With two publishers ROS time jumps to and fro, and every difference of two readings may be wrong. The symptoms do not
show the cause. It is detected by the number of publishers, and by the jumps, since a bridge may forward two clocks as
one publisher.
"""

from __future__ import annotations

import time
from collections import deque
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.clock import JumpThreshold
from rclpy.duration import Duration
from rclpy.node import Node

from diffbot_core.ros.publisher_watch import publisher_names, too_many
from diffbot_core.units import NS_PER_S

CLOCK_TOPIC = "/clock"
GRACE = 2.0
"""[s] for which a clock may be missing: at the start it has not been discovered yet"""
_JUMPS, _WINDOW = 3, 2.0
"""So many jumps back within so many seconds are two clocks; one is a simulation that was started again."""
_FORWARD = Duration(seconds=0.5)
"""A jump forward that makes :meth:`ClockWatch.now` look at the publishers before it answers."""
_SETTLE = 1.0
"""[s] for which time is not relied on after a jump back"""
_LOG_PERIOD = 1.0
"""[s] least time between two log entries"""


class ClockWatch:
    """What is wrong with the clock of one node, and a time that runs on while two clocks contradict each other."""

    def __init__(self, node: Node) -> None:
        """Watch the clock of ``node``; whether it uses /clock is looked up each time."""
        self._node = node
        self.problem = ""
        """what is wrong with /clock, in words; empty if nothing is"""
        self.contradictory = False
        """two clocks are the problem"""
        self._logged, self._log_time = "", -_LOG_PERIOD
        self._clock_seen = time.monotonic()
        self._jumps_back: deque[float] = deque(maxlen=_JUMPS)
        self._jumped = False
        self._ros_seen: int | None = None
        self._ros_changed = 0.0
        self._last: tuple[int, int] | None = None
        self._offset = 0
        threshold = JumpThreshold(min_forward=_FORWARD, min_backward=Duration(nanoseconds=-1), on_clock_change=False)
        self._handle = node.get_clock().create_jump_callback(threshold, post_callback=self._on_jump)

    @property
    def level(self) -> int:
        """Level of the problem in /diagnostics."""
        if self.contradictory:
            return int(DiagnosticStatus.ERROR[0])
        return int((DiagnosticStatus.WARN if self.problem else DiagnosticStatus.OK)[0])

    @property
    def is_simulated(self) -> bool:
        """True if the node follows /clock."""
        return self._uses_clock()

    @property
    def is_unreliable(self) -> bool:
        """True while two clocks contradict each other, and for a second after time has jumped back."""
        if self._jumped:
            self._jumped = False
            self.check()
        return self.contradictory or self._has_jumped_back()

    def standstill(self) -> float:
        """Return for how long [s, steady clock] calls of this method have found the same simulated time."""
        if not self._uses_clock():
            return 0.0
        ros, now = int(self._node.get_clock().handle.get_now().nanoseconds), time.monotonic()
        if ros != self._ros_seen:
            self._ros_seen, self._ros_changed = ros, now
        return now - self._ros_changed

    def now(self) -> float:
        """Return the node's time [s]; while two clocks contradict each other it runs on with the steady clock."""
        if self._jumped:
            self._jumped = False
            self.check()
        steady = time.monotonic_ns()
        if self.contradictory:
            return float((steady + self._offset) / NS_PER_S)
        # Clock.now() takes several times as long, and this is on the way of each command.
        ros = int(self._node.get_clock().handle.get_now().nanoseconds)
        self._last = ros, steady
        return float(ros / NS_PER_S)

    def check(self) -> None:
        """Look at the publishers of /clock and log a change of the problem; called once a second and after jumps."""
        was_contradictory = self.contradictory
        self.problem, self.contradictory = self._find_problem()
        if self.contradictory and not was_contradictory:
            ros, steady = self._last or (int(self._node.get_clock().now().nanoseconds), time.monotonic_ns())
            self._offset = ros - steady
        now = time.monotonic()
        if self.problem != self._logged and now - self._log_time >= _LOG_PERIOD:
            logger = self._node.get_logger()
            if not self.problem:
                logger.info("one publisher of /clock")
            elif self.contradictory:
                logger.error(self.problem)
            else:
                logger.warning(self.problem)
            self._logged, self._log_time = self.problem, now

    def _find_problem(self) -> tuple[str, bool]:
        publishers = publisher_names(self._node, CLOCK_TOPIC)
        now = time.monotonic()
        if publishers or not self._uses_clock():
            self._clock_seen = now
        if not self._uses_clock() and not self._publishes_clock():
            return "", False
        if text := too_many(CLOCK_TOPIC, publishers, 1, "own time"):
            return text, True
        if len(self._jumps_back) == _JUMPS and now - self._jumps_back[0] <= _WINDOW:
            return f"time on /clock jumps to and fro, as with two clocks; its publisher: {', '.join(publishers)}", True
        if self._has_jumped_back():
            return "time on /clock jumped back", False
        if now - self._clock_seen >= GRACE:
            return "use_sim_time is set, but nothing publishes /clock: time stands still", False
        return "", False

    def _uses_clock(self) -> bool:
        return bool(self._node.get_clock().ros_time_is_active)

    def _has_jumped_back(self) -> bool:
        return bool(self._jumps_back) and time.monotonic() - self._jumps_back[-1] < _SETTLE

    def _publishes_clock(self) -> bool:
        return any(publisher.topic_name == CLOCK_TOPIC for publisher in self._node.publishers)

    def _on_jump(self, jump: Any) -> None:
        # Called by rcl inside the clock's update: only note it.
        self._jumped = True
        if jump.delta.nanoseconds < 0:
            self._jumps_back.append(time.monotonic())
