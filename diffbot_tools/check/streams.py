"""Statistics of the messages of a running robot: rates, clocks, frames, covariances and drops. Does not import ROS.

A message is any object with the fields of its type. The code of the ekf reads the messages: its conversions decide
which messages it would drop, and its InputWatch detects faults that no single message shows.
"""

from __future__ import annotations

import math
import statistics
from collections import Counter
from contextlib import suppress
from itertools import pairwise
from typing import Any, NamedTuple

from diffbot_control.filter.odometry_check import MIN_RATE, MIN_SPEED, Agreement, with_rates
from diffbot_control.ros.input_watch import WINDOW, InputWatch
from diffbot_control.ros.messages.ekf import EkfInputs
from diffbot_control.ros.messages.fields import measured_ns, pose_of, stamp_ns
from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_control.ros.transforms import Transforms
from diffbot_core.errors import BadMessageError
from diffbot_core.kinematics import Twist
from diffbot_core.shared_parameters import odometry_frame
from diffbot_core.stamps import S_PER_NS, StampWatch

COMMANDS = "cmd_vel"
SYSTEM_CLOCK, SIMULATED_CLOCK = "system clock", "/clock"
_MAX_STEP = 1.0
"""[s] longest time between two odometry messages whose rates are compared"""


class MessageArrival(NamedTuple):
    """Times at which a message arrived."""

    steady: float
    """[s] on the steady clock"""
    system: int
    """[ns] on the system clock of this computer"""
    simulated: int | None = None
    """[ns] newest time on /clock; None before the first message on /clock"""


class Stream:
    """The messages of one topic."""

    def __init__(self) -> None:
        """Start without a message."""
        self.arrivals: list[float] = []
        """[s] on the steady clock"""
        self.ages: dict[str, list[float]] = {SYSTEM_CLOCK: [], SIMULATED_CLOCK: []}
        """[s] time from stamp to arrival, by the clock that measured it"""
        self.frames: Counter[str] = Counter()
        self.covariance = ""
        """covariance of the newest message, in words"""
        self.drops: Counter[str] = Counter()
        """number of messages that the ekf drops, by the kind of their error"""
        self.drop_texts: dict[str, str] = {}
        """newest error of each kind, with its details"""
        self.note = ""
        """assumption that the ekf makes about the messages"""
        self.repeated = 0
        """number of messages whose stamp is not later than all earlier stamps"""
        self._stamps = StampWatch()

    def add(self, message: Any, arrival: MessageArrival) -> None:
        """Add a message of any type."""
        self.arrivals.append(arrival.steady)
        if (header := getattr(message, "header", None)) is None:
            return
        self.frames[" -> ".join(filter(None, (header.frame_id, getattr(message, "child_frame_id", ""))))] += 1
        self.covariance = covariance_text(message)
        with suppress(BadMessageError):
            if stamp := stamp_ns(header.stamp):
                self.repeated += not self._stamps.advances(stamp)
                self.ages[SYSTEM_CLOCK].append((arrival.system - stamp) * S_PER_NS)
                if arrival.simulated is not None:
                    self.ages[SIMULATED_CLOCK].append((arrival.simulated - stamp) * S_PER_NS)

    def drop(self, error: BadMessageError) -> None:
        """Count a message that the ekf would drop."""
        self.drops[error.kind] += 1
        self.drop_texts[error.kind] = str(error)

    @property
    def rate(self) -> float:
        """Messages per second between the first and the newest message; 0 for fewer than two messages."""
        time = self.arrivals[-1] - self.arrivals[0] if self.arrivals else 0.0
        return (len(self.arrivals) - 1) / time if time > 0.0 else 0.0

    @property
    def gap(self) -> float:
        """Longest time [s] between two messages."""
        return max((after - before for before, after in pairwise(self.arrivals)), default=0.0)

    def clock(self) -> tuple[str, float]:
        """Return the clock that stamps the messages and their median age [s]; an empty text and NaN without stamps."""
        medians = {clock: statistics.median(ages) for clock, ages in self.ages.items() if ages}
        # The stamps are closest to the clock that made them.
        return min(medians.items(), key=lambda item: abs(item[1]), default=("", math.nan))


def covariance_text(message: Any) -> str:
    """Return the standard deviations that the filter reads from a message; empty for a type without covariance."""
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
    """The messages of all topics of a robot, read as its ekf reads them."""

    def __init__(self, config: EkfNodeConfig, transforms: Transforms) -> None:
        """Store the configuration of the ekf and the transforms to the frames of its sensors."""
        self.config = config
        self._inputs = EkfInputs(config, transforms)
        self.sensors = self._inputs.sensors
        wheels = config.left_wheel_name, config.right_wheel_name
        delays = {topic: sensor.usual_delay for topic, sensor in self.sensors.items()}
        self._watch = InputWatch(config.odometry_source, wheels, delays)
        self._window_end = -math.inf
        self._streams: dict[str, Stream] = {}
        self._gyro_turns = Agreement()
        """agreement of the turn rates of wheels and gyro"""
        self._speeds, self._turns = Agreement(), Agreement()
        """agreement of commands and odometry"""
        self._has_driven = False
        """True after a message of the odometry whose twist shows a motion"""
        self._gyro: float | None = None
        self._command: Twist | None = None
        self._stamp: int | None = None

    def stream(self, name: str) -> Stream:
        """Return the stream of a topic, by the name that the node gives it."""
        return self._streams.setdefault(name, Stream())

    def clocks(self) -> dict[str, str]:
        """Return the clock of each topic with stamped messages, by the name of the topic."""
        clocks = {name: stream.clock()[0] for name, stream in self._streams.items()}
        return {name: clock for name, clock in clocks.items() if clock}

    @property
    def has_moved(self) -> bool:
        """True if the odometry has shown a motion, by its twist or its pose."""
        return self._has_driven or bool(self._watch.odometry.fault())

    def add(self, name: str, message: Any, arrival: MessageArrival) -> None:
        """Add a message."""
        stream = self.stream(name)
        stream.add(message, arrival)
        if arrival.steady >= self._window_end:
            self._window_end = arrival.steady + WINDOW
            self._watch.clocks.end_window()
        try:
            if name == self.config.odometry_source or name in self.sensors:
                # A message that is dropped below still shows a wrong clock.
                self._watch.clocks.add(name, measured_ns(message.header.stamp), arrival.system)
            if name == COMMANDS:
                twist = getattr(message, "twist", message)
                self._command = Twist(twist.linear.x, twist.angular.z)
            elif name == self.config.odometry_source:
                self._add_odometry(message)
            elif name in self.sensors:
                content = self.sensors[name].read(message)
                stream.note = content.assumed or stream.note
                self._gyro = content.gyro.rate if content.gyro is not None else self._gyro
        except BadMessageError as error:
            stream.drop(error)

    def _add_odometry(self, message: Any) -> None:
        if self.config.odometry_source == "odom":
            step = self._inputs.odometry(message)
            expected = odometry_frame(self.config) if self.config.publish_tf else ""
            self._watch.receive_frame(message.header.frame_id, expected)
            with suppress(BadMessageError):
                self._watch.odometry.add(step.stamp, pose_of(message.pose.pose), step.twist)
        else:
            wheels = self._inputs.joint_states(message)
            self._watch.receive_joints(tuple(message.name), has_wheels=wheels is not None)
            if wheels is None:
                return
            step = wheels
        dt = 0.0 if self._stamp is None else (step.stamp - self._stamp) * S_PER_NS
        self._stamp = step.stamp
        v, omega = step.twist.v, step.twist.omega
        self._has_driven = self._has_driven or abs(v) > MIN_SPEED or abs(omega) > MIN_RATE
        if not 0.0 < dt < _MAX_STEP:
            return
        if self._gyro is not None:
            self._gyro_turns = with_rates(self._gyro_turns, dt, omega, self._gyro, MIN_RATE)
        if self._command is not None:
            self._speeds = with_rates(self._speeds, dt, self._command.v, v, MIN_SPEED)
            self._turns = with_rates(self._turns, dt, self._command.omega, omega, MIN_RATE)

    def faults(self) -> dict[str, str]:
        """Return a text about each fault that InputWatch detects, by the input at fault."""
        return self._watch.faults(self._gyro_turns, is_simulated=SIMULATED_CLOCK in self.clocks().values())

    def command_fault(self) -> str:
        """Return how the odometry contradicts the commands; empty if it does not."""
        for agreement, verb in ((self._turns, "turn"), (self._speeds, "drive")):
            kind = agreement.contradiction()
            if kind == "opposed":
                return (
                    f"the robot {verb}s in the direction opposite to its commands: swap left and right wheel, or the "
                    "sign of the motors"
                )
            if kind == "only_first":
                return f"the robot is commanded to {verb} but does not: enable the motors, release the emergency stop"
        return ""
