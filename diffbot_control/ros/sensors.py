"""Sensors of the ekf: conversion of messages to measurements.

This module does not import ROS: a message is any object with the fields of its type. To add a sensor, add a class here
and create it in :func:`sensors_of`.

An all-zero covariance in a message means *unknown*, not *exact*. The deviations of the parameters replace it. If they
are 0, the message is dropped.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from diffbot_control.filter.config import GLOBAL_POSE
from diffbot_control.filter.covariance import UnknownCovarianceError, check_covariance
from diffbot_control.filter.localization import Localization
from diffbot_control.filter.measurement import FIXES, GyroSample, Measurement, heading, landmark, pose_fix
from diffbot_control.filter.models import Array
from diffbot_control.ros.messages.fields import (
    MAX_SPEED,
    check_frame,
    check_numbers,
    measured_ns,
    planar_covariance,
    pose_of,
    stamp_ns,
    yaw_of,
)
from diffbot_control.ros.messages.landmark_cloud import LandmarkPoint, landmark_points
from diffbot_control.ros.parameters.dock import POSE, DockDetection
from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_control.ros.transforms import (
    Mounting,
    Transforms,
    pose_in_frame,
    rotated,
    rotated_covariance,
    yaw_through,
)
from diffbot_core.errors import BadMessageError
from diffbot_core.geometry import Pose
from diffbot_core.shared_parameters import robot_frame
from diffbot_core.stamps import S_PER_NS

POSE_MESSAGE = "geometry_msgs/msg/PoseWithCovarianceStamped"
DETECTIONS = "detected_dock_pose"
_DOCK_GROWTH = 0.01
"""[m/m], [rad/m] increase of the deviations of a detection without covariance per metre of distance"""


class KnownNoise(NamedTuple):
    """Covariance of a sensor according to the parameters, for messages without a covariance."""

    R: Array | None = None
    """fallback covariance; None: drop messages without a covariance"""
    always: bool = False
    """use R even if a message has a covariance"""
    parameters: str = ""
    """names of the parameters that set R, for the error text"""
    sigmas: tuple[float, ...] = ()
    """deviations of the parameters; with ``always``, those that are not 0 replace the deviations of a message"""

    def covariance_or_fallback(self, read: Callable[[], Array]) -> Array:
        """Return the covariance that ``read`` returns, or R if this covariance is unknown or overridden.

        Raises:
            BadMessageError: if the covariance is invalid, or unknown without a fallback.
        """
        if self.always and self.R is not None:
            return self.R
        try:
            return self._overridden(read()) if self.always and any(self.sigmas) else read()
        except UnknownCovarianceError as error:
            if self.R is None and self.parameters:
                remedy = f"set {self.parameters}, or have the driver fill the covariance"
                raise UnknownCovarianceError(error.kind, remedy) from None
            if self.R is None:
                raise
            return self.R

    def _overridden(self, R: Array) -> Array:
        given, result = np.flatnonzero(self.sigmas), R.copy()
        result[given, :] = result[:, given] = 0.0
        result[given, given] = np.square(self.sigmas)[given]
        return result


def diagonal(sigmas: Sequence[float]) -> Array | None:
    """Return the covariance of independent errors; None if a standard deviation is 0: unknown."""
    return np.diag(np.square(sigmas)) if all(sigmas) else None


class SensorContent(NamedTuple):
    """Content of one message of a sensor."""

    measurements: list[Measurement]
    uses_fallback: bool = False
    """True if the covariance is from the parameters"""
    unknown: int = 0
    """number of landmarks that are not on the map"""
    gyro: GyroSample | None = None
    """turn rate of an Imu"""
    assumed: str = ""
    """assumption about the mounting of the sensor, and how to avoid it; empty if the mounting is known"""


class Sensor(ABC):
    """A source of measurements."""

    usual_delay = 0.0
    """[s] typical delay from a measurement until its message is published"""

    def __init__(self, topic: str, message_type: str, noise: KnownNoise, frame: str) -> None:
        """Create the sensor.

        Args:
            topic: topic of its messages.
            message_type: type of its messages, e.g. ``sensor_msgs/msg/Imu``.
            noise: covariance for messages without a covariance.
            frame: frame of the measurements.
        """
        self.topic, self.message_type, self.noise, self.frame = topic, message_type, noise, frame

    @abstractmethod
    def read(self, message: Any) -> SensorContent:
        """Return the measurements of a message.

        Raises:
            BadMessageError: if the message cannot be used.
        """


class FixSensor(Sensor):
    """One source of fixes. If the deviation of the heading is pi or more, only the position of a fix is used."""

    usual_delay = 0.1

    def __init__(self, topic: str, source: str, noise: KnownNoise, frame: str, delay: float) -> None:
        """Create the sensor; ``source`` is its name in the filter, ``delay`` [s] the time from a fix to its stamp."""
        super().__init__(topic, POSE_MESSAGE, noise, frame)
        self._source, self._delay = source, round(delay / S_PER_NS)

    def read(self, message: Any) -> SensorContent:
        """Return the fix of a message."""
        _, pose, R = stamped_pose(message, self.frame, self.noise)
        stamp = measured_ns(message.header.stamp)
        return SensorContent([pose_fix(stamp - self._delay, pose, R, self._source)], R is self.noise.R)


class ImuSensor(Sensor):
    """An Imu, which may be mounted in any orientation."""

    def __init__(self, topic: str, noise: KnownNoise, frame: str, transforms: Transforms) -> None:
        """Create the sensor; ``transforms`` lead from ``frame``, the frame of the robot, to the frame of the Imu."""
        super().__init__(topic, "sensor_msgs/msg/Imu", noise, frame)
        self._mounting = Mounting(frame, transforms)

    def _variance(self, covariance: Any) -> Array:
        """Return the variance (1, 1) about the z axis from the 9 numbers of a covariance."""
        return self.noise.covariance_or_fallback(lambda: check_covariance(np.array([[float(covariance[8])]])))


class Compass(ImuSensor):
    """The heading, from the orientation of an Imu."""

    def read(self, message: Any) -> SensorContent:
        """Return the heading of a message; REP-145: covariance[0] = -1 means no orientation."""
        if message.orientation_covariance[0] == -1.0:
            raise BadMessageError("no orientation", "orientation_covariance[0] is -1")
        stamp, yaw = measured_ns(message.header.stamp), yaw_of(message.orientation)
        mounted = self._mounting.rotation_to(message.header.frame_id, stamp)
        if mounted is not None:
            yaw = yaw_through(message.orientation, mounted)
        R = self._variance(message.orientation_covariance)
        return SensorContent([heading(stamp, yaw, R)], R is self.noise.R, assumed=self._mounting.assumed)


class Gyro(ImuSensor):
    """The turn rate about the robot's vertical axis, from an Imu."""

    def read(self, message: Any) -> SensorContent:
        """Return the turn rate of a message; REP-145: covariance[0] = -1 means no angular velocity."""
        if message.angular_velocity_covariance[0] == -1.0:
            raise BadMessageError("no angular velocity", "angular_velocity_covariance[0] is -1")
        rates, stamp, axis = message.angular_velocity, measured_ns(message.header.stamp), (0.0, 0.0, 1.0)
        measured = rates.x, rates.y, rates.z
        check_numbers(measured, MAX_SPEED, "turn rate")
        mounted = self._mounting.rotation_to(message.header.frame_id, stamp)
        if mounted is not None:
            # Vertical axis of the robot in the frame of the Imu.
            axis = rotated(axis, mounted)
        rate = sum(component * share for component, share in zip(measured, axis, strict=True))
        R = self._variance(message.angular_velocity_covariance)
        sample = GyroSample(stamp, rate, R.item(0))
        return SensorContent([], R is self.noise.R, gyro=sample, assumed=self._mounting.assumed)


class LandmarkSensor(Sensor):
    """Range and bearing of the landmarks of a map."""

    def __init__(self, noise: KnownNoise, frame: str, config: EkfNodeConfig) -> None:
        """Create the sensor for the map in ``config``; ``frame`` is the frame of the robot."""
        super().__init__("landmarks", "sensor_msgs/msg/PointCloud2", noise, frame)
        self._map = config.landmarks.points()

    def read(self, message: Any) -> SensorContent:
        """Return the measurements of the known landmarks in a message."""
        check_frame(message.header.frame_id, self.frame)
        stamp, measurements, unknown = measured_ns(message.header.stamp), [], 0
        for point in landmark_points(message):
            if point.number not in self._map:
                unknown += 1
                continue
            R = _landmark_noise(point, self.noise)
            measurements.append(landmark(stamp, point.range, point.bearing, R, self._map[point.number]))
        return SensorContent(measurements, unknown=unknown)


def _landmark_noise(point: LandmarkPoint, noise: KnownNoise) -> Array:
    """Return R (2, 2) of range and bearing; the variance of a number that was not measured is inf."""
    variances = point.var_range, point.var_bearing
    measured = [index for index in (0, 1) if math.isfinite(variances[index])]
    if not measured:
        raise BadMessageError("no finite variance", f"of landmark {point.number}")
    part = np.ix_(measured, measured)
    known = noise._replace(R=None if noise.R is None else noise.R[part])
    R = np.diag((math.inf, math.inf))
    R[part] = known.covariance_or_fallback(lambda: check_covariance(np.diag([variances[index] for index in measured])))
    return R


class DockSensor(Sensor):
    """Detections of a dock. Each detection is a fix in the frame of the dock.

    A detection may have any frame with a transform to the frame of the robot. Without a transform it is dropped, since
    its position would be wrong.
    """

    usual_delay = 0.3

    def __init__(self, dock: DockDetection, override_covariance: bool, frame: str, transforms: Transforms) -> None:
        """Create the sensor; ``transforms`` lead from the detector to ``frame``, the frame of the robot."""
        self._has_covariance = dock.dock_detection != POSE
        message_type = POSE_MESSAGE if self._has_covariance else "geometry_msgs/msg/PoseStamped"
        super().__init__(DETECTIONS, message_type, KnownNoise(always=override_covariance), frame)
        self._dock, self._docked, self._transforms = dock, dock.docked(), transforms
        self._newest: Pose | None = None

    def read(self, message: Any) -> SensorContent:
        """Return the fix of the robot in the frame of the dock.

        Raises:
            BadMessageError: if the message cannot be used, or has the same pose as the previous message.
        """
        pose = message.pose.pose if self._has_covariance else message.pose
        marker = pose_in_frame(pose, message.header, self.frame, self._transforms)
        if marker == self._newest:
            # The noise of a working detector makes each pose different.
            raise BadMessageError("same pose as before", "restart the detector")
        self._newest = marker
        growth = _DOCK_GROWTH * math.hypot(pose.position.x, pose.position.y, pose.position.z)
        sigma, yaw_sigma = self._dock.dock_sigma + growth, self._dock.dock_yaw_sigma + growth
        R = assumed = np.diag(np.square((sigma, sigma, yaw_sigma)))
        if self._has_covariance:
            R = self.noise._replace(R=assumed).covariance_or_fallback(lambda: self._covariance(message))
        at_dock = check_covariance(self._docked.covariance(marker, R))
        fix = pose_fix(measured_ns(message.header.stamp), self._docked.robot(marker), at_dock)
        return SensorContent([fix], R is assumed)

    def _covariance(self, message: Any) -> Array:
        """Return the covariance (3, 3) of the pose of the marker in the frame of the robot."""
        covariance, source = message.pose.covariance, message.header.frame_id
        if source != self.frame:
            transform = self._transforms.lookup(self.frame, source, stamp_ns(message.header.stamp))
            covariance = rotated_covariance(covariance, transform.rotation)
        return planar_covariance(covariance)


def sensors_of(config: EkfNodeConfig, transforms: Transforms) -> list[Sensor]:
    """Return the sensors of a configuration, in the order in which their waiting messages are handled.

    ``transforms`` lead from the frames of the Imu and of the detector to the frame of the robot.
    """
    noise, frame, robot = config.noise, config.map_frame, robot_frame(config)
    dock: Any = config.dock

    def known(*sigmas: float) -> KnownNoise:
        return KnownNoise(diagonal(sigmas), noise.override_covariance, sigmas=sigmas)

    sensors: list[Sensor] = [FixSensor(GLOBAL_POSE, FIXES, global_pose_noise(config), frame, 0.0)]
    for one in config.localization.sources.settings():
        sigmas = known(one.sigma_xy, one.sigma_xy, one.sigma_yaw)
        sensors.append(FixSensor(one.topic, one.source, sigmas, frame, one.delay))
    sensors.append(
        Compass("heading", known(noise.heading_sigma)._replace(parameters="heading_sigma"), robot, transforms)
    )
    if config.landmarks.landmark_ids:
        sensors.append(LandmarkSensor(known(noise.landmark_range_sigma, noise.landmark_bearing_sigma), robot, config))
    if config.localization.filter.use_gyro:
        sensors.append(Gyro("imu", known(noise.gyro_sigma), robot, transforms))
    if isinstance(dock, DockDetection):
        sensors.append(DockSensor(dock, noise.override_covariance, robot, transforms))
    return sensors


def global_pose_noise(config: EkfNodeConfig) -> KnownNoise:
    """Return the fallback covariance of ``global_pose`` and ``initialpose``."""
    xy, yaw = config.noise.global_pose_sigma_xy, config.noise.global_pose_sigma_yaw
    names = "global_pose_sigma_xy and global_pose_sigma_yaw"
    return KnownNoise(diagonal((xy, xy, yaw)), config.noise.override_covariance, names, (xy, xy, yaw))


def stamped_pose(message: Any, frame: str, noise: KnownNoise) -> tuple[int, Pose, Array]:
    """Return stamp [ns], pose and covariance (3, 3) of a PoseWithCovarianceStamped in ``frame``."""
    check_frame(message.header.frame_id, frame, parameter="map_frame")
    pose = pose_of(message.pose.pose)
    R = noise.covariance_or_fallback(lambda: planar_covariance(message.pose.covariance))
    return stamp_ns(message.header.stamp), pose, R


def fuse(content: SensorContent, localization: Localization, drop: Callable[[BadMessageError], None]) -> None:
    """Fuse the measurements of a message.

    Args:
        content: content of the message.
        localization: filter.
        drop: called with the error of each dropped measurement, if the message has several measurements.

    Raises:
        BadMessageError: if the only measurement, or the turn rate, is dropped.
    """
    if content.gyro is not None:
        localization.on_gyro(content.gyro)
    errors = localization.on_measurements(content.measurements)
    for error in errors:
        if len(content.measurements) == 1:
            raise error
        drop(error)
