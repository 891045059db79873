"""An independent observer of a robot: the times of its commands, and outputs that are not finite."""

import array
import contextlib
import math
import os
import signal
import time
from pathlib import Path

from geometry_msgs.msg import PoseWithCovarianceStamped, Twist
from nav_msgs.msg import Odometry
from robot import DEEP, twist

FAR = (5000.0, 0.0, 0.0)
"""A goal that is not reached during a test."""
PERIOD = 0.1
"""[s] of plant, poses and commands"""
POSE_TIMEOUT = 0.5
"""[s] the controller's default"""
COMMAND_TIMEOUT = 0.5
"""[s] cmd_vel_timeout, the plant's default"""
NEVER = 3600.0
"""[s] cmd_vel_timeout for tests in which the controller has to stop the robot, not its base"""
LOST_INPUT = POSE_TIMEOUT + PERIOD
"""[s] until the controller stops a robot without poses"""
LOST_COMMANDS = COMMAND_TIMEOUT + PERIOD
"""[s] until a base without commands stops"""
NEAR = {"initial_pose.x": -4.0, "initial_pose.y": 0.2, "initial_pose.yaw": 0.0}
STANDSTILL = 0.2
"""[s] without motion after which a robot counts as stopped"""
OUTPUTS = {
    "cmd_vel": Twist,
    "pose": PoseWithCovarianceStamped,
    "odometry/filtered": Odometry,
    "ground_truth": Odometry,
    "odom": Odometry,
}


def numbers_of(message):
    found = []
    for name in message.get_fields_and_field_types():
        value = getattr(message, name)
        if hasattr(value, "get_fields_and_field_types"):
            found += numbers_of(value)
        elif isinstance(value, float):
            found.append(value)
        elif isinstance(value, array.array) or type(value).__name__ == "ndarray":
            found += map(float, value)
    return found


class Witness:
    """Keeps commands and true speeds with their times of receipt (monotonic), and checks every output."""

    def __init__(self, robot):
        self.robot, self.peer = robot, robot.peer
        self.commands, self.truths = [], []
        self.non_finite = []
        self.killed = set()
        self._waited = {}
        for topic, kind in OUTPUTS.items():
            self.peer.node.create_subscription(
                kind, topic, lambda message, topic=topic: self._check(topic, message), DEEP
            )

    def _check(self, topic, message):
        now = time.monotonic()
        if not all(map(math.isfinite, numbers_of(message))):
            self.non_finite.append((topic, message))
        if topic == "cmd_vel":
            self.commands.append((now, twist(message)))
        elif topic == "ground_truth":
            self.truths.append((now, twist(message.twist)))

    def drive(self):
        # The last status of a killed controller may name the same goal.
        self.robot.controller_states.clear()
        self.robot.send_goal(*FAR, tries=5)
        self.until_moving()

    def until_moving(self):
        """Wait for a fast command that is newer than this call, and for motion of the base."""
        self.robot.catch_up()
        commands, truths = len(self.commands), len(self.truths)
        self.peer.spin_until(
            lambda: (
                any(abs(v) > 0.3 for _, (v, _) in self.commands[commands:])
                and any(abs(v) > 0.3 for _, (v, _) in self.truths[truths:])
            ),
            what="motion",
        )

    def wait(self, random):
        """Wait for a random part of a period, so that faults happen at all of its phases."""
        self.peer.spin_for(random.uniform(0.0, 0.1))

    def moments(self, trials, random, drive=None):
        """Yield the number of each trial at a random moment of a drive; check that the robot moves after it.

        ``drive`` makes the robot move; by default it moves again when the fault has ended.
        """
        drive = drive or self.until_moving
        for number in trials:
            drive()
            self.wait(random)
            yield number
        drive()

    def check_stop(self, trials, bound, since, received=None):
        """Check that the robot stopped within ``bound`` [s] after a fault at ``since``, see :meth:`stop_after`."""
        seconds = self.stop_after(since, received)
        assert seconds <= trials.bound(bound, self.delay())

    def stop_after(self, since, received=None):
        """Return the time [s] from ``since`` to the first zero after which only zeros are received.

        ``received`` are the commands by default, or the true speeds of a base that stops by itself.
        """
        received = self.commands if received is None else received
        zero = (0.0, 0.0)

        def stands():
            if not received or received[-1][0] < since or received[-1][1] != zero:
                return False
            return time.monotonic() - first_of_the_last_zeros() >= STANDSTILL

        def first_of_the_last_zeros():
            first = received[-1][0]
            for at, value in reversed(received):
                if value != zero or at < since:
                    break
                first = at
            return first

        self.peer.spin_until(stands, what="standstill")
        return first_of_the_last_zeros() - since

    def kill(self, name, number=signal.SIGKILL):
        process = self.robot.processes[name]
        since = self.mark()
        process.send(number)
        if number == signal.SIGKILL:
            self.killed.add(process)
        return since

    def mark(self):
        """Begin a trial: return the time, and keep how long each thread has waited for a processor until now."""
        self._waited = self._waits()
        return time.monotonic()

    def delay(self):
        """Return the delay by the scheduler since :meth:`mark` [s]: the most delayed thread of each process, summed."""
        longest = {}
        for (pid, thread), waited in self._waits().items():
            longest[pid] = max(longest.get(pid, 0.0), waited - self._waited.get((pid, thread), waited))
        return sum(longest.values())

    def _waits(self):
        """Return how long [s] each thread of the robot and of this process has waited, by process and thread."""
        pids = [os.getpid(), *(one.popen.pid for one in self.robot.processes.values() if one.popen.poll() is None)]
        found = {}
        for path in (path for pid in pids for path in Path(f"/proc/{pid}/task").glob("*/schedstat")):
            # A thread may end meanwhile.
            with contextlib.suppress(OSError):
                found[path.parts[2], path.parts[4]] = int(path.read_text().split()[1]) * 1e-9
        return found

    def audit(self):
        """Fail if a process died or printed a traceback, or if an output was not finite."""
        for process in self.robot.launched:
            assert "Traceback" not in process.output
            assert process in self.killed or process.popen.poll() in (None, 0), "died, see the log of the process"
        assert not self.non_finite, self.non_finite[0]
