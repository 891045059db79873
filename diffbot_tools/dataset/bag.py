"""A drive to a bag, stamped with the data's own time, with ``ekf.yaml`` in its folder."""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import yaml
from tqdm import tqdm

from diffbot_bag.bag.encoding import ODOMETRY, POSE, Encoder, NumbersMessage
from diffbot_bag.bag.new_bag import new_bag
from diffbot_bag.bag.qos import Qos
from diffbot_control.filter.models import move
from diffbot_control.ros.messages.fields import fill_unestimated
from diffbot_control.ros.messages.landmark_cloud import fill_landmark_points
from diffbot_core.geometry import Pose, quaternion_of_yaw
from diffbot_core.units import NS_PER_S, S_PER_NS
from diffbot_tools.dataset.drive import Cloud, Drive, Measured, TruePose, start_of

EKF_FILE = "ekf.yaml"
"""Parameters of the node ``ekf`` for a bag, in its folder."""
CLOUD = "sensor_msgs/msg/PointCloud2"
MAP, ODOM, BASE = "map", "odom", "base_link"
TOPICS = {"/initialpose": POSE, "/landmarks": CLOUD, "/ground_truth": ODOMETRY, "/odom": ODOMETRY}
"""In this order at equal times: the filter answers an odometry, which therefore comes last."""
UNKNOWN_VARIANCE = 1e6
"""[m^2], [rad^2] of what is not measured"""
_TRUTH_VARIANCE = 1e-6

_Event = tuple[int, int, bytes]
"""Stamp [ns], place of the topic in TOPICS, CDR bytes."""


def write_drive(drive: Drive, out: Path) -> int:
    """Write the bag, with a progress bar on a terminal; return the number of messages.

    Raises:
        DiffbotError: if ``out`` exists or cannot be written, a message type is not installed, or no odometry has a true
            pose to start from.
    """
    start, pose = start_of(drive)
    encoder = Encoder()
    odometry = [one for one in drive.odometry if one.stamp >= start]
    events = heapq.merge(
        [(start, 0, _initialpose(drive, start, pose))],
        (_cloud(encoder, cloud) for cloud in drive.clouds),
        _truth(drive.truth),
        _odometry(odometry),
        key=lambda event: event[:2],
    )
    total = 1 + len(drive.clouds) + len(drive.truth) + len(odometry)
    with new_bag(out) as writer:
        channels = [
            writer.add_topic(name, kind, (Qos(reliability="reliable", durability="volatile"),))
            for name, kind in TOPICS.items()
        ]
        (writer.folder / EKF_FILE).write_text(ekf_yaml(drive), encoding="utf-8")
        for stamp, topic, data in tqdm(events, desc=drive.name, total=total, unit="message", disable=None):
            writer.write(channels[topic], data, stamp, stamp)
    return total


def ekf_yaml(drive: Drive) -> str:
    """Return a ROS parameter file for the node ``ekf``: the map, and the settings for this kind of robot."""
    parameters = {
        **drive.parameters,
        "landmark_ids": list(drive.landmarks),
        "landmark_x": [one.x for one in drive.landmarks.values()],
        "landmark_y": [one.y for one in drive.landmarks.values()],
    }
    content = {"/**/ekf": {"ros__parameters": parameters}}
    head = f"# For the bag of {drive.name}; all parameters are in docs/reference/parameters.\n"
    return head + yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=120)


def _initialpose(drive: Drive, stamp: int, pose: Pose) -> bytes:
    message = NumbersMessage(POSE, MAP)
    xy, yaw = drive.start_sigmas
    _fill(message, pose)
    message.pose_covariance[[0, 7, 35]] = xy**2, xy**2, yaw**2
    fill_unestimated(message.pose_covariance)
    return message.encode(stamp)


def _cloud(encoder: Encoder, cloud: Cloud) -> _Event:
    sec, nanosec = divmod(cloud.stamp, NS_PER_S)
    message: Any = SimpleNamespace(header={"stamp": {"sec": sec, "nanosec": nanosec}, "frame_id": BASE})
    fill_landmark_points(message, cloud.points, SimpleNamespace)
    return cloud.stamp, 1, encoder.encode(CLOUD, message)


def _truth(truth: list[TruePose]) -> Iterator[_Event]:
    message = NumbersMessage(ODOMETRY, MAP, BASE)
    fill_unestimated(message.pose_covariance)
    message.twist_covariance[::7] = UNKNOWN_VARIANCE
    for stamp, pose in truth:
        known = math.isfinite(pose.theta)
        _fill(message, pose if known else pose._replace(theta=0.0))
        message.pose_covariance[[0, 7, 35]] = (
            _TRUTH_VARIANCE,
            _TRUTH_VARIANCE,
            _TRUTH_VARIANCE if known else UNKNOWN_VARIANCE,
        )
        yield stamp, 2, message.encode(stamp)


def _odometry(odometry: list[Measured]) -> Iterator[_Event]:
    """Yield the odometry with the pose that it leads to; all covariances are zero: unknown."""
    message = NumbersMessage(ODOMETRY, ODOM, BASE)
    pose, last = Pose(0.0, 0.0, 0.0), odometry[0].stamp
    for stamp, twist in odometry:
        pose, last = move(pose, twist, (stamp - last) * S_PER_NS).end, stamp
        _fill(message, pose)
        message.twist[[0, 5]] = twist
        yield stamp, 3, message.encode(stamp)


def _fill(message: NumbersMessage, pose: Pose) -> None:
    message.position[:2] = pose.x, pose.y
    message.orientation[2:] = np.array(quaternion_of_yaw(pose.theta))
