"""What the messages of a running robot show: rates, clocks, frames, covariances, drops. Free of ROS.

A message is anything with the fields of its type. The rules are those of the ekf: its conversions decide which message
it would drop, and its InputWatch names faults that no single message shows.
"""

from __future__ import annotations

import math
import statistics
from collections import Counter
from contextlib import suppress
from itertools import pairwise
from typing import Any, NamedTuple

from diffbot_control.filter.odometry import OdometryStep
from diffbot_control.filter.odometry_check import MIN_RATE, MIN_SPEED, Agreement, with_rates
from diffbot_control.ros.frames import odometry_frame
from diffbot_control.ros.input_watch import WINDOW, InputWatch
from diffbot_control.ros.messages.ekf import EkfInputs
from diffbot_control.ros.messages.fields import measured_ns, pose_of, stamp_ns
from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_control.ros.transforms import Transforms
from diffbot_core.errors import BadMessageError
from diffbot_core.kinematics import Twist
from diffbot_core.stamps import S_PER_NS, StampWatch

ODOMETRY_TOPICS = ("odom", "joint_states")
COMMANDS = "cmd_vel"
_MAX_STEP = 1.0
"""[s] between two odometry messages whose rates are compared"""


class Arrival(NamedTuple):
    """When a message arrived."""

    steady: float
    """[s] on the steady clock"""
    system: int
    """[ns] on the system clock of this computer"""
    simulated: int | None = None
    """[ns] newest time on /clock; None: nothing was received on it"""


class Stream:
    """What the messages of one topic showed."""

    def __init__(self) -> None:
        """Start without a message."""
        self.arrivals: list[float] = []
        """[s] steady"""
        self.ages: list[float] = []
        """[s] between stamp and arrival on the system clock"""
        self.simulated_ages: list[float] = []
        """[s] the same on /clock"""
        self.frames: Counter[str] = Counter()
        self.covariance = ""
        """covariance of the newest message, in words"""
        self.drops: Counter[str] = Counter()
        """messages that the ekf drops, by the kind of their error"""
        self.drop_texts: dict[str, str] = {}
        """the newest error of each kind, with its details"""
        self.note = ""
        """what the ekf assumes about the messages"""
        self.repeated = 0
        """messages whose stamp is not later than that of all earlier ones"""
        self._stamps = StampWatch()

    def add(self, message: Any, arrival: Arrival) -> None:
        """Add a message of any type."""
        self.arrivals.append(arrival.steady)
        if (header := getattr(message, "header", None)) is None:
            return
        self.frames[" -> ".join(filter(None, (header.frame_id, getattr(message, "child_frame_id", ""))))] += 1
        self.covariance = covariance_text(message)
        with suppress(BadMessageError):
            if stamp := stamp_ns(header.stamp):
                self.repeated += not self._stamps.advances(stamp)
                self.ages.append((arrival.system - stamp) * S_PER_NS)
                if arrival.simulated is not None:
                    self.simulated_ages.append((arrival.simulated - stamp) * S_PER_NS)

    def drop(self, error: BadMessageError) -> None:
        """Count a message that the ekf would drop."""
        self.drops[error.kind] += 1
        self.drop_texts[error.kind] = str(error)

    @property
    def rate(self) -> float:
        """Messages per second between the first and the newest one; 0 for fewer than two."""
        time = self.arrivals[-1] - self.arrivals[0] if self.arrivals else 0.0
        return (len(self.arrivals) - 1) / time if time > 0.0 else 0.0

    @property
    def gap(self) -> float:
        """Longest time [s] between two messages."""
        return max((after - before for before, after in pairwise(self.arrivals)), default=0.0)

    def clock(self) -> tuple[str, float]:
        """Return the clock that stamps the messages, and their median age [s] on it; NaN without stamps."""
        if not self.ages:
            return "", math.nan
        ages = {"system clock": self.ages, "/clock": self.simulated_ages}
        medians = {name: statistics.median(found) for name, found in ages.items() if found}
        name = min(medians, key=lambda one: abs(medians[one]))
        return name, medians[name]


def covariance_text(message: Any) -> str:
    """Return the standard deviations that the filter would read from a message; empty for a type without covariance."""
    variances: list[tuple[float, str]] = []
    if hasattr(message, "angular_velocity_covariance"):
        variances = [(message.angular_velocity_covariance[8], "rad/s")]
    elif hasattr(message, "twist") and hasattr(message.twist, "covariance"):
        variances = [(message.twist.covariance[0], "m/s"), (message.twist.covariance[35], "rad/s")]
    elif hasattr(message, "pose") and hasattr(message.pose, "covariance"):
        variances = [(message.pose.covariance[at], unit) for at, unit in ((0, "m"), (7, "m"), (35, "rad"))]
    if not variances:
        return ""
    if not any(variance for variance, _ in variances):
        return "covariance unknown (0)"
    sigmas = [f"{math.sqrt(one):.2g} {unit}" if one >= 0.0 else f"sqrt({one:.2g}) {unit}" for one, unit in variances]
    return "sigma " + ", ".join(sigmas)


class Streams:
    """The streams of a robot, read as its ekf reads them."""

    def __init__(self, config: EkfNodeConfig, transforms: Transforms) -> None:
        """Store the configuration of the ekf and the transforms to the frames of its sensors."""
        self.config = config
        self._inputs = EkfInputs(config, transforms)
        self.sensors = self._inputs.sensors
        delays = {topic: one.usual_delay for topic, one in self.sensors.items()}
        wheels = config.left_wheel_name, config.right_wheel_name
        self.watch = InputWatch(config.odometry_source, wheels, delays)
        self._window_end = math.inf
        self.streams: dict[str, Stream] = {}
        self.gyro_turns = Agreement()
        """of the turn rates of wheels and gyro"""
        self.speeds, self.turns = Agreement(), Agreement()
        """of command and odometry"""
        self.has_moved = False
        self._gyro: float | None = None
        self._command: Twist | None = None
        self._stamp: int | None = None

    def stream(self, name: str) -> Stream:
        """Return the stream of a topic, by the name that the node gives it."""
        return self.streams.setdefault(name, Stream())

    def add(self, name: str, message: Any, arrival: Arrival) -> None:
        """Add a message."""
        stream = self.stream(name)
        stream.add(message, arrival)
        if arrival.steady >= self._window_end or self._window_end == math.inf:
            self._window_end = arrival.steady + WINDOW
            self.watch.clocks.end_window()
        try:
            if name == self.config.odometry_source or name in self.sensors:
                # Before other faults: those of the clock are named beside them.
                self.watch.clocks.add(name, measured_ns(message.header.stamp), arrival.system)
            if name == COMMANDS:
                twist = getattr(message, "twist", message)
                self._command = Twist(twist.linear.x, twist.angular.z)
            elif name == self.config.odometry_source:
                self._add_odometry(message, arrival)
            elif name in self.sensors:
                content = self.sensors[name].read(message)
                stream.note = content.assumed or stream.note
                self._gyro = content.gyro.rate if content.gyro is not None else self._gyro
        except BadMessageError as error:
            stream.drop(error)

    def _add_odometry(self, message: Any, arrival: Arrival) -> None:
        step: OdometryStep | None
        if self.config.odometry_source == "odom":
            step = self._inputs.odometry(message)
            expected = odometry_frame(self.config) if self.config.publish_tf else ""
            self.watch.receive_frame(message.header.frame_id, expected)
            with suppress(BadMessageError):
                self.watch.odometry.add(step.stamp, pose_of(message.pose.pose), step.twist)
        else:
            step = self._inputs.joint_states(message)
            self.watch.receive_joints(tuple(message.name), has_wheels=step is not None)
        if step is None:
            return
        dt = 0.0 if self._stamp is None else (step.stamp - self._stamp) * S_PER_NS
        self._stamp = step.stamp
        v, omega = step.twist.v, step.twist.omega
        self.has_moved = self.has_moved or abs(v) > MIN_SPEED or abs(omega) > MIN_RATE
        if not 0.0 < dt < _MAX_STEP:
            return
        if self._gyro is not None:
            self.gyro_turns = with_rates(self.gyro_turns, dt, omega, self._gyro, MIN_RATE)
        if self._command is not None:
            self.speeds = with_rates(self.speeds, dt, self._command.v, v, MIN_SPEED)
            self.turns = with_rates(self.turns, dt, self._command.omega, omega, MIN_RATE)

    def faults(self, *, is_simulated: bool) -> dict[str, str]:
        """Return what InputWatch finds, by the input at fault."""
        return self.watch.faults(self.gyro_turns, is_simulated=is_simulated)

    def command_fault(self) -> str:
        """Return how the odometry contradicts the commands; empty if it does not."""
        for memory, what in ((self.turns, "turns"), (self.speeds, "drives")):
            if (kind := memory.contradiction()) == "opposed":
                return f"the robot {what} against its commands: swap left and right wheel, or the sign of the motors"
            if kind == "only_first":
                return f"the robot is commanded, but no longer {what}: enable the motors, release the emergency stop"
        return ""
