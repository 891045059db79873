"""The command ``diffbot refilter``: run the filter over a bag, and write estimates and innovations into a new bag.

No node runs. Equal inputs give equal outputs, to the bit.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from tqdm import tqdm

from diffbot_bag.bag import BagReader, DecodedMessage
from diffbot_bag.messages import encode, make
from diffbot_bag.writer import BagWriter, new_bag
from diffbot_control.filter import ekf
from diffbot_control.filter.localization import FilterEstimate, Localization
from diffbot_control.filter.measurement import Measurement
from diffbot_control.filter.models import is_defined
from diffbot_control.filter.odometry import OdometryStep
from diffbot_control.ros.messages.ekf import EkfInputs
from diffbot_control.ros.messages.fields import (
    fill_planar_covariance,
    fill_pose,
    fill_twist,
    fill_twist_covariance,
    fill_unestimated,
    set_stamp,
)
from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_control.ros.sensors import POSE_MESSAGE, Sensor, fuse, sensors_of
from diffbot_control.ros.transforms import NO_TRANSFORMS
from diffbot_core.errors import BadMessageError, DiffbotError, InvalidValueError, known_name, shown
from diffbot_core.files import read_text
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist, TwistCovariance
from diffbot_core.shared_parameters import robot_frame
from diffbot_core.stamps import S_PER_NS
from diffbot_core.yaml_files import MAX_BYTES
from diffbot_tools.filter_statistics import (
    NIS_LABELS,
    NIS_TOPIC,
    Innovation,
    consistency_of_innovations,
    errors_at,
    errors_text,
    read_truth,
)
from diffbot_tools.opened_bag import open_bag
from diffbot_tools.parameter_file import read_config

PARAMETERS = "ekf.yaml"
"""Parameter file in the folder of a bag, which is used without --params."""
ODOMETRY, NIS = "nav_msgs/msg/Odometry", "std_msgs/msg/Float64MultiArray"
INPUTS = {
    "global_pose": POSE_MESSAGE,
    "heading": "sensor_msgs/msg/Imu",
    "imu": "sensor_msgs/msg/Imu",
    "landmarks": "sensor_msgs/msg/PointCloud2",
    "initialpose": POSE_MESSAGE,
    "odom": ODOMETRY,
    "joint_states": "sensor_msgs/msg/JointState",
}
"""Type of each topic that the filter reads, by the name that the node gives the topic."""


class Answer(NamedTuple):
    """Output of the filter for one odometry message."""

    estimate: FilterEstimate
    twist: Twist
    """twist of the odometry, corrected by the gyro and the estimated errors of the wheels"""
    covariance: TwistCovariance


def run(bag: Path, params: Path | None, out: Path, compare: str | None, remap: dict[str, str]) -> int:
    """Filter a bag, write the new bag, and print the dropped messages, the consistency and the errors.

    Args:
        bag: folder of a bag, or an .mcap file.
        params: ROS parameter file; None: ``ekf.yaml`` in the folder of the bag.
        out: folder of the new bag.
        compare: topic of true poses in ``bag``; None: print no errors.
        remap: topic in the bag by the name of an input, see :func:`inputs_of`, for topics whose names differ.

    Raises:
        DiffbotError: if a file or topic is missing, a parameter is not allowed, or ``out`` already exists.
    """
    if os.path.lexists(out):
        raise DiffbotError(f"{out} already exists: choose another name for the bag")
    file = parameter_file_of(bag, params)
    config = read_config(file)
    with open_bag(bag) as reader:
        truth = None if compare is None else read_truth(reader, compare)
        filtered = FilterRun(config, topics_of(reader, config, remap))
        innovations = filtered.localization.innovations
        with new_bag(out) as writer:
            (writer.folder / PARAMETERS).write_text(read_text(file, MAX_BYTES), encoding="utf-8")
            estimates = _filter_bag(filtered, reader, _Output(writer, config))
    for (topic, kind), count in sorted(filtered.dropped.items()):
        print(f"{topic}: dropped {count}: {kind}")
    accepted = sum(one.accepted for one in innovations)
    nis, correlation, bound = consistency_of_innovations(innovations)
    stamps = np.array([one.stamp for one in estimates], dtype=np.int64)
    print(f"estimates             {len(estimates)} in {(stamps[-1] - stamps[0]) * S_PER_NS:.1f} s")
    print(f"measurements          {accepted} accepted, {len(innovations) - accepted} rejected")
    print(f"NIS per number, mean  {nis:.3f} (1 if consistent)")
    print(f"whiteness, lag 1      {correlation:+.3f} (white: within +-{bound:.3f})")
    if truth is not None:
        poses, P = np.array([one.pose for one in estimates]), np.array([one.P for one in estimates])
        print(errors_text(errors_at(stamps, poses, P, truth)))
    print(out)
    return 0


def parameter_file_of(bag: Path, params: Path | None) -> Path:
    """Return the parameter file for a bag: ``params``, or by default ``ekf.yaml`` in the folder of the bag.

    Raises:
        DiffbotError: if the bag or the parameter file does not exist.
    """
    if not bag.exists():
        raise DiffbotError(f"there is no bag {bag}")
    if params is not None:
        return params
    folder = bag if bag.is_dir() else bag.parent
    path = folder / PARAMETERS
    if not path.is_file():
        raise DiffbotError(f"{folder} has no {PARAMETERS}: give a parameter file with --params")
    return path


def inputs_of(config: EkfNodeConfig) -> dict[str, str]:
    """Return INPUTS and the topics of the configured sensors, with their types."""
    return INPUTS | {one.topic: one.message_type for one in sensors_of(config, NO_TRANSFORMS)}


def topics_of(reader: BagReader, config: EkfNodeConfig, remap: dict[str, str]) -> dict[str, str]:
    """Return the input (see :func:`inputs_of`) that each topic of a bag provides.

    Raises:
        DiffbotError: if the bag lacks the odometry, a configured source of fixes or a remapped topic, if a topic has
            another type than the filter reads, or if ``remap`` has an unknown name.
    """
    inputs, found, path = inputs_of(config), reader.topics, shown(reader.path)
    own = {name.lstrip("/"): name for name in inputs}
    for name in remap:
        if name not in own:
            raise InvalidValueError("--remap", name, known_name(name, own))
    remap = {own[name]: topic for name, topic in remap.items()}
    names = {name: "/" + remap.get(name, name).lstrip("/") for name in inputs}
    for name in (*remap, config.odometry_source, *config.localization.sources.pose_sources):
        if names[name] not in found:
            raise DiffbotError(f"{path} has no topic {names[name]} for {name}, only {shown(', '.join(sorted(found)))}")
    for name, topic in names.items():
        if topic in found and found[topic].type != inputs[name]:
            raise DiffbotError(
                f"{path}: {topic} has the type {shown(found[topic].type)}; {name} must be {inputs[name]}"
            )
    return {topic: name for name, topic in names.items() if topic in found}


class RecordingLocalization(Localization):
    """A localization that stores the innovation of each measurement, once even if the measurement is fused again."""

    def __init__(self, config: EkfNodeConfig) -> None:
        """Start without a pose."""
        separation, landmarks = config.wheels.wheel_separation, tuple(config.landmarks.points().values())
        super().__init__(config.localization, separation, config.sensor_timeout, landmarks=landmarks)
        self.innovations: list[Innovation] = []

    def _take(self, measurement: Measurement, *, is_new: bool) -> int:
        reading = self.reading_of(measurement)
        if not is_new or not is_defined(reading, self.filter.x):
            return super()._take(measurement, is_new=is_new)
        expected, S = ekf.innovation(self.filter, self.options, reading)
        nis = ekf.normalised_square(expected.y, S)
        outcome = super()._take(measurement, is_new=True)
        used = outcome in (ekf.ACCEPTED, ekf.WEIGHED)
        source = measurement.source, measurement.at
        self.innovations.append(Innovation(measurement.stamp, source, expected.y, S, nis, used))
        return outcome


class FilterRun:
    """A filter that processes recorded messages as the node ``ekf`` does, and counts dropped messages."""

    def __init__(self, config: EkfNodeConfig, topics: dict[str, str]) -> None:
        """Start without a pose; ``topics`` is the result of :func:`topics_of`."""
        self._inputs = EkfInputs(config)
        self.localization = RecordingLocalization(config)
        self.dropped: Counter[tuple[str, str]] = Counter()
        """number of dropped messages, by topic and reason"""
        handlers: dict[str, Callable[[str, Any], Answer | None]] = {
            "initialpose": self._on_initialpose,
            config.odometry_source: self._on_odometry,
        }
        handlers |= {one.topic: partial(self._on_sensor, one) for one in self._inputs.sensors.values()}
        self._odometry_of = self._inputs.odometry if config.odometry_source == "odom" else self._inputs.joint_states
        self._handlers = {topic: handlers[name] for topic, name in topics.items() if name in handlers}

    @property
    def topics(self) -> tuple[str, ...]:
        """Topics of the bag that the filter reads."""
        return tuple(self._handlers)

    def take(self, message: DecodedMessage) -> Answer | None:
        """Process one message of :attr:`topics`; return the answer to a usable odometry message, otherwise None."""
        try:
            return self._handlers[message.topic](message.topic, message.content)
        except BadMessageError as error:
            self.dropped[message.topic, error.kind] += 1
            return None

    def reasons(self) -> str:
        """Return the most frequent reasons for dropped messages; empty if no message was dropped."""
        return "; ".join(f"{topic}: {kind} ({count})" for (topic, kind), count in self.dropped.most_common(3))

    def _on_sensor(self, sensor: Sensor, topic: str, message: Any) -> None:
        content = sensor.read(message)
        if content.unknown:
            self.dropped[topic, "unknown number"] += content.unknown
        fuse(content, self.localization, lambda error: self.dropped.update([(topic, error.kind)]))

    def _on_initialpose(self, _topic: str, message: Any) -> None:
        stamp, pose, R = self._inputs.initialpose(message)
        self.localization.initialise(pose, R, stamp or None)

    def _on_odometry(self, _topic: str, message: Any) -> Answer | None:
        odometry = self._odometry_of(message)
        return None if odometry is None else self._answer(odometry)

    def _answer(self, odometry: OdometryStep) -> Answer | None:
        estimate = self.localization.on_odometry(odometry)
        return Answer(estimate, *self.localization.twist_of(estimate, odometry))


class _Output:
    """Writer of pose and odometry/filtered, as the node ``ekf`` publishes them, and of the NIS of each measurement.

    The publish time of a message of ``/ekf/nis`` is the stamp of the measurement. Its log time is the log time of the
    odometry message at which the filter fuses the measurement.
    """

    def __init__(self, writer: BagWriter, config: EkfNodeConfig) -> None:
        """Add the topics to the bag."""
        self._writer = writer
        header = {"frame_id": config.map_frame}
        self._pose = make(POSE_MESSAGE, header=header)
        self._odometry = make(ODOMETRY, header=header, child_frame_id=robot_frame(config))
        self._nis_message = make(NIS, layout={"dim": [{"label": one, "size": 1, "stride": 1} for one in NIS_LABELS]})
        fill_unestimated(self._pose.pose.covariance)
        fill_unestimated(self._odometry.pose.covariance, self._odometry.twist.covariance)
        self._poses = writer.add_topic("/pose", POSE_MESSAGE)
        self._filtered = writer.add_topic("/odometry/filtered", ODOMETRY)
        self._nis = writer.add_topic(NIS_TOPIC, NIS)
        self._written = 0

    def write(self, answer: Answer, innovations: list[Innovation], log_time: int) -> None:
        """Write an answer, and the NIS of the ``innovations`` that were not written before, at ``log_time`` [ns]."""
        estimate, twist, covariance = answer
        for message in (self._pose, self._odometry):
            set_stamp(message.header.stamp, estimate.stamp)
            fill_pose(message.pose.pose, Pose(*estimate.pose))
            fill_planar_covariance(message.pose.covariance, estimate.P)
        fill_twist(self._odometry.twist.twist, twist)
        fill_twist_covariance(self._odometry.twist.covariance, covariance)
        self._writer.write(self._poses, encode(POSE_MESSAGE, self._pose), log_time, estimate.stamp)
        self._writer.write(self._filtered, encode(ODOMETRY, self._odometry), log_time, estimate.stamp)
        for one in innovations[self._written :]:
            self._nis_message.data = np.array([one.nis, len(one.y), one.accepted], float)
            self._writer.write(self._nis, encode(NIS, self._nis_message), log_time, one.stamp)
        self._written = len(innovations)


def _filter_bag(filtered: FilterRun, reader: BagReader, output: _Output) -> list[FilterEstimate]:
    """Process all messages in the order of their log times; return the estimates.

    Raises:
        DiffbotError: if the filter gives no estimate.
    """
    estimates, total = [], sum(reader.topics[topic].message_count for topic in filtered.topics)
    messages = reader.decoded(filtered.topics)
    for message in tqdm(messages, desc="refilter", total=total, unit="message", disable=None):
        answer = filtered.take(message)
        if answer is not None:
            estimates.append(answer.estimate)
            output.write(answer, filtered.localization.innovations, message.log_time)
    if not estimates:
        raise DiffbotError(f"{reader.path} gives no estimate: {filtered.reasons() or 'it has no messages'}")
    return estimates
