"""The filter over messages in the order of a recording, as the node ``ekf`` handles them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

from diffbot_bag.bag.reader import DecodedMessage
from diffbot_control.filter.gate import ACCEPTED, IGNORED, WEIGHED
from diffbot_control.filter.innovation_monitor import InnovationMonitor
from diffbot_control.filter.localization import FilterEstimate, Localization
from diffbot_control.filter.measurements import Array, Measurement, Source
from diffbot_control.filter.odometry import OdometryStep
from diffbot_control.ros.messages.ekf import EkfInputs
from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_control.ros.sensors import sensors_of
from diffbot_control.ros.sensors.fixes import POSE_MESSAGE
from diffbot_control.ros.sensors.sensor import Sensor, fuse
from diffbot_core.errors import BadMessageError
from diffbot_core.kinematics import Twist

INPUTS = {
    "global_pose": POSE_MESSAGE,
    "heading": "sensor_msgs/msg/Imu",
    "imu": "sensor_msgs/msg/Imu",
    "landmarks": "sensor_msgs/msg/PointCloud2",
    "initialpose": POSE_MESSAGE,
    "odom": "nav_msgs/msg/Odometry",
    "joint_states": "sensor_msgs/msg/JointState",
}
"""Topics that the filter reads, as the node names them, and their types."""


def inputs_of(config: EkfNodeConfig) -> dict[str, str]:
    """Return INPUTS and the topics of further sensors of a configuration, with their types."""
    return INPUTS | {one.topic: one.message_type for one in sensors_of(config)}


class Innovation(NamedTuple):
    """One measurement at the filter."""

    stamp: int
    """[ns]"""
    source: Source
    y: Array
    """(m,) innovation"""
    S: Array
    """(m, m) its covariance"""
    nis: float
    accepted: bool


class Answer(NamedTuple):
    """What the filter makes of one odometry message."""

    estimate: FilterEstimate
    odometry: OdometryStep
    twist: Twist
    """corrected by the estimated radius errors"""


class _RecordingMonitor(InnovationMonitor):
    """A monitor that keeps the newest outcome."""

    outcome = IGNORED

    def record(self, source: Source, nis: float, outcome: int, *more: Any) -> None:
        """Add a measurement, as the base class does."""
        super().record(source, nis, outcome, *more)
        self.outcome = outcome


class RecordingLocalization(Localization):
    """A localization that keeps the innovations of its measurements, each once, however late it was fused."""

    def __init__(self, config: EkfNodeConfig) -> None:
        """Start unknown."""
        separation, landmarks = config.wheels.wheel_separation, bool(config.landmarks.landmark_ids)
        super().__init__(config.localization, separation, config.sensor_timeout, landmarks=landmarks)
        self.monitor = self._recorder = _RecordingMonitor()
        self.innovations: list[Innovation] = []

    def _update(self, measurement: Measurement, new: bool = True) -> None:
        super()._update(measurement, new)
        innovation = self.filter.innovation
        if not new or innovation is None:
            return
        used = self._recorder.outcome in (ACCEPTED, WEIGHED)
        self.innovations.append(Innovation(measurement.stamp, measurement.source, *innovation, self.filter.nis, used))


class FilterRun:
    """A filter that takes recorded messages, and counts those that it drops."""

    def __init__(self, config: EkfNodeConfig, topics: dict[str, str]) -> None:
        """Start unknown; ``topics`` maps the topics of the bag to those of :func:`inputs_of`."""
        self._inputs = EkfInputs(config)
        self.localization = RecordingLocalization(config)
        self.dropped: Counter[tuple[str, str]] = Counter()
        """messages that were not used, by topic and reason"""
        handlers: dict[str, Callable[[str, Any], Answer | None]] = {
            "initialpose": self._on_initialpose,
            config.odometry_source: self._on_odometry if config.odometry_source == "odom" else self._on_joint_states,
        }
        handlers |= {one.topic: partial(self._on_sensor, one) for one in self._inputs.sensors}
        self._handlers = {topic: handlers[name] for topic, name in topics.items() if name in handlers}

    @property
    def topics(self) -> tuple[str, ...]:
        """Topics of the bag that the filter reads."""
        return tuple(self._handlers)

    def take(self, message: DecodedMessage) -> Answer | None:
        """Handle one message of :attr:`topics`; return the filter's answer to an odometry that it can use."""
        try:
            return self._handlers[message.topic](message.topic, message.content)
        except BadMessageError as error:
            self.dropped[message.topic, error.kind] += 1
            return None

    def _on_sensor(self, sensor: Sensor, topic: str, message: Any) -> None:
        reading = sensor.read(message)
        if reading.unknown:
            self.dropped[topic, "unknown number"] += reading.unknown
        fuse(reading, self.localization, lambda error: self.dropped.update([(topic, error.kind)]))

    def _on_initialpose(self, _topic: str, message: Any) -> None:
        fix = self._inputs.initialpose(message)
        self.localization.initialise(fix.pose, fix.R, fix.stamp or None)

    def _on_odometry(self, _topic: str, message: Any) -> Answer:
        return self._answer(self._inputs.odometry(message))

    def _on_joint_states(self, _topic: str, message: Any) -> Answer:
        return self._answer(self._inputs.joint_states(message))

    def _answer(self, odometry: OdometryStep) -> Answer:
        estimate = self.localization.on_odometry(odometry)
        odometry = estimate.odometry or odometry
        return Answer(estimate, odometry, self.localization.twist_of(estimate, odometry)[0])
