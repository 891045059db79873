"""Watches of /clock and of topics with a limited number of publishers, which detect faults of the graph.

With two publishers of /clock, ROS time jumps back and forth. With two controllers on one cmd_vel, the robot follows
them in turn; with two sources of the pose, the controller follows two estimates. Each single message is valid, so only
the number of publishers shows the cause.
"""

from __future__ import annotations

import time
from collections import deque
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.clock import JumpThreshold
from rclpy.duration import Duration
from rclpy.node import Node

from diffbot_core.ros.graph import publisher_names
from diffbot_core.stamps import NS_PER_S

CLOCK_TOPIC = "/clock"
GRACE = 2.0
"""[s] A missing clock is reported after this time, because discovery takes a moment."""
LEASE = 20.0
"""[s] Fast DDS counts the publishers of a killed process for this time after its end."""
_JUMPS, _WINDOW = 3, 2.0
"""This number of jumps back within this time [s] means two clocks; a single jump means a restarted simulation."""
_FORWARD = Duration(seconds=0.5)
"""After a larger jump forward, the publishers of /clock are counted again."""
_SETTLE = 1.0
"""[s] Time for which the clock is unreliable after a jump back."""
_LOG_PERIOD = 1.0
"""[s] Shortest time between two log entries."""
_OK, _WARN, _ERROR = (int(one[0]) for one in (DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR))


def too_many(topic: str, names: list[str], limit: int, role: str) -> str:
    """Return a text if a topic has more than ``limit`` publishers; otherwise an empty text.

    Args:
        topic: full name of the topic.
        names: full name of the node of each publisher.
        limit: largest number of publishers.
        role: what a publisher of the topic does, to complete "only one may ...".
    """
    if len(names) <= limit:
        return ""
    allowed = "one" if limit == 1 else str(limit)
    return f"{len(names)} publishers of {topic}, only {allowed} may {role}: {', '.join(names)}"


class ClockWatch:
    """Detects faults of a node's clock, and provides a steady time while two clocks contradict each other.

    Two clocks are detected by the number of publishers and by jumps back, because a bridge may forward two clocks as
    one publisher.
    """

    def __init__(self, node: Node) -> None:
        """Watch the clock of ``node``; ``use_sim_time`` may change later."""
        self._node = node
        self.problem = ""
        """description of the fault of /clock; empty if there is none"""
        self.contradictory = False
        """True if there are two clocks"""
        self._logged, self._log_time = "", -_LOG_PERIOD
        self._clock_found = time.monotonic()
        self._jumps_back: deque[float] = deque(maxlen=_JUMPS)
        self._jumped = False
        self._last_ros_time: int | None = None
        self._standstill_start = 0.0
        self._last: tuple[int, int] | None = None
        self._offset = 0
        threshold = JumpThreshold(min_forward=_FORWARD, min_backward=Duration(nanoseconds=-1), on_clock_change=False)
        self._handle = node.get_clock().create_jump_callback(threshold, post_callback=self._on_jump)

    @property
    def level(self) -> int:
        """Level of the problem in /diagnostics."""
        return _ERROR if self.contradictory else _WARN if self.problem else _OK

    @property
    def is_simulated(self) -> bool:
        """True if the node uses /clock."""
        return bool(self._node.get_clock().ros_time_is_active)

    @property
    def is_unreliable(self) -> bool:
        """True while two clocks contradict each other, and for a second after time has jumped back."""
        self._check_after_jump()
        return self.contradictory or self._has_jumped_back()

    def standstill(self) -> float:
        """Return the steady time [s] since the first call of this method with the present simulated time."""
        if not self.is_simulated:
            return 0.0
        ros, now = self._ros_time(), time.monotonic()
        if ros != self._last_ros_time:
            self._last_ros_time, self._standstill_start = ros, now
        return now - self._standstill_start

    def now(self) -> float:
        """Return the time [s] of the node, which is steady while two clocks contradict each other."""
        self._check_after_jump()
        steady = time.monotonic_ns()
        if self.contradictory:
            return float((steady + self._offset) / NS_PER_S)
        ros = self._ros_time()
        self._last = ros, steady
        return float(ros / NS_PER_S)

    def check(self) -> None:
        """Check the clock and log a change of the problem; called once a second and after jumps."""
        was_contradictory = self.contradictory
        self.problem, self.contradictory = self._find_problem()
        if self.contradictory and not was_contradictory:
            ros, steady = self._last or (self._ros_time(), time.monotonic_ns())
            self._offset = ros - steady
        now = time.monotonic()
        if self.problem != self._logged and now - self._log_time >= _LOG_PERIOD:
            logger = self._node.get_logger()
            if not self.problem:
                logger.info("the problem with /clock has ended")
            elif self.contradictory:
                logger.error(self.problem)
            else:
                logger.warning(self.problem)
            self._logged, self._log_time = self.problem, now

    def _find_problem(self) -> tuple[str, bool]:
        publishers = publisher_names(self._node, CLOCK_TOPIC)
        now, simulated = time.monotonic(), self.is_simulated
        if publishers or not simulated:
            self._clock_found = now
        if not simulated and all(publisher.topic_name != CLOCK_TOPIC for publisher in self._node.publishers):
            return "", False
        if text := too_many(CLOCK_TOPIC, publishers, 1, "set the time"):
            return text, True
        if len(self._jumps_back) == _JUMPS and now - self._jumps_back[0] <= _WINDOW:
            names = ", ".join(publishers)
            return f"time on /clock jumps to and fro, as with two clocks; publisher: {names}", True
        if self._has_jumped_back():
            return "time on /clock jumped back", False
        if now - self._clock_found >= GRACE:
            return "use_sim_time is set, but nothing publishes /clock: time stands still", False
        return "", False

    def _ros_time(self) -> int:
        # Clock.now() is several times slower, and each command needs the time.
        return int(self._node.get_clock().handle.get_now().nanoseconds)

    def _has_jumped_back(self) -> bool:
        return bool(self._jumps_back) and time.monotonic() - self._jumps_back[-1] < _SETTLE

    def _check_after_jump(self) -> None:
        if self._jumped:
            self._jumped = False
            self.check()

    def _on_jump(self, jump: Any) -> None:
        # rcl is updating the clock, so only set a flag.
        self._jumped = True
        if jump.delta.nanoseconds < 0:
            self._jumps_back.append(time.monotonic())


class PublisherWatch:
    """Detects topics with more publishers than allowed, even if the publishers do not send messages."""

    def __init__(self, node: Node) -> None:
        """Watch no topic."""
        self._node = node
        self.problem = ""
        """description of the topics with too many publishers; empty if there are none"""
        self._watched: dict[str, tuple[str, int]] = {}
        """role and limit by full topic name"""
        self._reported: dict[str, str] = {}
        self._since: dict[str, float] = {}
        self.level = _OK
        """level of the problem in /diagnostics: WARN while the surplus publishers may belong to a killed process"""

    def watch(self, topic: str, role: str, limit: int = 1) -> None:
        """Watch a topic, or change its limit.

        Args:
            topic: name of the topic in the code of the node, before remapping.
            role: what a publisher of the topic does, see :func:`too_many`.
            limit: largest number of publishers, including the publisher of the node.
        """
        self._watched[self._node.resolve_topic_name(topic)] = role, limit

    def check(self, active: bool = True) -> None:
        """Count publishers and log each change; called once a second.

        Args:
            active: False for a node that does not use its topics at present, so that any publishers are allowed.
        """
        found, level, now = {}, _OK, time.monotonic()
        for topic, (role, limit) in self._watched.items() if active else ():
            names = publisher_names(self._node, topic)
            if not (text := too_many(topic, names, limit, role)):
                continue
            since = self._since.setdefault(topic, now)
            may_be_killed = len(set(names)) <= limit and now - since <= 1.5 * LEASE
            found[topic] = text + f" (the publisher of a killed node still counts for {LEASE:g} s)" * may_be_killed
            level = max(level, _WARN if may_be_killed else _ERROR)
        self._log(found)
        self._since = {topic: since for topic, since in self._since.items() if topic in found}
        self.problem, self.level = "; ".join(found.values()), level

    def _log(self, found: dict[str, str]) -> None:
        logger = self._node.get_logger()
        for topic, text in found.items():
            if text != self._reported.get(topic):
                logger.error(text)
        for topic in self._reported.keys() - found.keys():
            logger.info(f"{topic}: the number of publishers is within the limit again")
        self._reported = found
