"""Faults of /clock while poses continue: it stands still, jumps back or ahead, or has two publishers."""

import threading
import time
from contextlib import closing

import graph
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.qos import QoSProfile, ReliabilityPolicy
from repeated import tried
from robot import SIMULATED
from rosgraph_msgs.msg import Clock
from witness import LOST_INPUT, NEAR, NEVER

JUMP = 500 * 10**9
"""[ns]"""
CLOCK_PERIOD = 0.01
BEST_EFFORT = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)


class ClockSource:
    """Publishes the time of day plus ``offset`` [ns] in a thread of its own."""

    def __init__(self, peer, offset=0):
        self.publisher = peer.publisher(Clock, "/clock", BEST_EFFORT)
        self.offset, self.stands = offset, False
        self.changed = 0.0
        """monotonic time of the last message sent"""
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def start(self):
        """Begin to publish; return the monotonic time before."""
        since = time.monotonic()
        self._thread.start()
        return since

    def _run(self):
        message = Clock()
        while not self._ended.wait(CLOCK_PERIOD):
            if not self.stands:
                message.clock.sec, message.clock.nanosec = divmod(time.time_ns() + self.offset, 10**9)
                self.changed = time.monotonic()
                self.publisher.publish(message)

    def close(self):
        self._ended.set()
        self._thread.join()


@pytest.fixture(scope="module")
def timed(observed):
    with graph.peer("clock_source") as peer, closing(ClockSource(peer)) as source:
        source.start()
        plant = {**NEAR, "clock": "wall", "cmd_vel_timeout": NEVER}
        with observed(plant, SIMULATED, SIMULATED, only=("robot", "plant"), joined=True) as witness:
            witness.source = source
            witness.drive()
            yield witness


def first_command(witness, since, is_expected):
    """Return the time of the first such command: after a jump back the robot stands for only a second."""

    def times():
        return [at for at, command in witness.commands if at >= since and is_expected(*command)]

    return witness.peer.spin_until(times, what="the command")[0]


def first_zero(witness, since):
    return first_command(witness, since, lambda v, omega: v == omega == 0.0)


@tried(20)
def test_a_clock_that_stands_still_stops_the_robot(timed, trials, seeded):
    for _ in timed.moments(trials, seeded):
        timed.mark()
        timed.source.stands = True
        try:
            timed.peer.spin_for(2 * CLOCK_PERIOD)
            timed.check_stop(trials, LOST_INPUT, timed.source.changed)
        finally:
            timed.source.stands = False


@tried(10)
def test_a_clock_that_jumps_back_stops_the_robot(timed, trials, seeded):
    for _ in timed.moments(trials, seeded):
        since = timed.mark()
        timed.source.offset -= JUMP
        assert first_zero(timed, since) - since <= trials.bound(LOST_INPUT, timed.delay())


@tried(10)
def test_a_clock_that_jumps_ahead_does_not_end_the_goal(timed, trials, seeded):
    for _ in timed.moments(trials, seeded):
        since = timed.mark()
        timed.source.offset += JUMP
        timed.peer.spin_for(0.3)
        first = first_command(timed, since + 0.2, lambda v, _: v > 0.3)
        assert first - since <= trials.bound(1.0, timed.delay())


def named(messages):
    """Return True if the controller names the second clock in an error."""
    found = [one for message in messages for one in message.status if one.name.endswith("controller")]
    return any(one.level == DiagnosticStatus.ERROR and "second_clock" in one.message for one in found)


@tried(10)
def test_a_second_publisher_of_clock_stops_the_robot_and_is_named(timed, trials, seeded):
    for _ in timed.moments(trials, seeded):
        with graph.peer("second_clock") as peer, closing(ClockSource(peer, -JUMP)) as second:
            peer.wait_for_subscribers(second.publisher, count=2)
            timed.mark()
            since = second.start()
            first, delay = first_zero(timed, since), timed.delay()
            timed.peer.spin_until(lambda: named(timed.robot.diagnostics[-9:]), what="the second clock on /diagnostics")
        assert first - since <= trials.bound(LOST_INPUT, delay)
