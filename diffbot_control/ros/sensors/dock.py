"""A dock that is seen: its pose in the frame of a detector on the robot, on ``detected_dock_pose``."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from diffbot_control.filter.covariance import check_covariance
from diffbot_control.filter.measurements import FIXES, Array, PoseFix, Source
from diffbot_control.ros.frames import robot_frame
from diffbot_control.ros.messages.fields import check_frame, planar_covariance, pose_of, stamp_ns
from diffbot_control.ros.parameters.dock import POSE
from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_control.ros.sensors.noise import KnownNoise, noise_of
from diffbot_control.ros.sensors.sensor import Reading
from diffbot_core.errors import BadMessageError
from diffbot_core.geometry import Pose

DETECTIONS = "detected_dock_pose"
_SOURCE = Source(FIXES)


class DockSensor:
    """The source of detections: each is a fix of the robot in the dock's frame."""

    topic = DETECTIONS

    def __init__(self, config: EkfNodeConfig) -> None:
        """Take mounting, frame and noise."""
        self._config, self._mounting = config.dock, config.dock.mounting()
        self._frame = config.dock.detector_frame or robot_frame(config)
        self._has_covariance = config.dock.dock_detection != POSE
        kind = "PoseWithCovarianceStamped" if self._has_covariance else "PoseStamped"
        self.message_type = f"geometry_msgs/msg/{kind}"
        self._overrides = config.noise.override_covariance
        self._newest: Pose | None = None

    def read(self, message: Any) -> Reading:
        """Return the fix that a detection is.

        Raises:
            BadMessageError: for a message that cannot be used, or the same pose as in the message before.
        """
        check_frame(message.header.frame_id, self._frame)
        inner = message.pose.pose if self._has_covariance else message.pose
        detected = pose_of(inner)
        if detected == self._newest:
            # A detector that hangs; one that measures has noise.
            raise BadMessageError("the same pose again")
        self._newest = detected
        distance, config = math.hypot(detected.x, detected.y), self._config
        sigma = config.dock_sigma + config.dock_sigma_per_metre * distance
        yaw_sigma = config.dock_yaw_sigma + config.dock_yaw_sigma_per_metre * distance
        assumed: Array = np.diag(np.square((sigma, sigma, yaw_sigma)))
        R = assumed
        if self._has_covariance:
            R = noise_of(lambda: planar_covariance(message.pose.covariance), KnownNoise(assumed, self._overrides))
        at_dock = check_covariance(self._mounting.covariance(detected, R))
        fix = PoseFix(stamp_ns(message.header.stamp), self._mounting.robot(detected), at_dock, _SOURCE)
        return Reading([fix], R is assumed)
