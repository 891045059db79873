"""Parameters of the node ``dock_ekf``, an ekf whose poses are in the frame of a detected dock."""

from __future__ import annotations

import math
from types import MappingProxyType
from typing import Annotated, NamedTuple

from diffbot_control.filter.dock import DockedPose
from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_core.schema import HEADING, POSITION, Spec, variant

POSE, POSE_WITH_COVARIANCE = "pose", "pose_with_covariance"


class DockDetection(NamedTuple):
    """The detections of a dock, and the pose of the docked robot in the frame of the detected marker."""

    dock_detection: Annotated[
        str,
        Spec(
            "type of detected_dock_pose: PoseStamped or PoseWithCovarianceStamped",
            choices=(POSE, POSE_WITH_COVARIANCE),
            read_only=True,
        ),
    ] = POSE_WITH_COVARIANCE
    docked_x: Annotated[float, Spec("x of the docked robot in the frame of the detected marker", "m", *POSITION)] = 0.0
    docked_y: Annotated[float, Spec("y of the docked robot in the frame of the detected marker", "m", *POSITION)] = 0.0
    docked_yaw: Annotated[
        float, Spec("heading of the docked robot in the frame of the detected marker", "rad", *HEADING)
    ] = 0.0
    dock_sigma: Annotated[
        float,
        Spec(
            "standard deviation of x and y of a detection without covariance; each metre of distance adds 1 cm",
            "m",
            1e-4,
            10.0,
        ),
    ] = 0.01
    dock_yaw_sigma: Annotated[
        float,
        Spec(
            "standard deviation of the heading of a detection without covariance; each metre of distance adds 0.01 rad",
            "rad",
            1e-4,
            math.pi,
        ),
    ] = 0.02

    def docked(self) -> DockedPose:
        """Return the pose of the docked robot in the frame of the detected marker."""
        return DockedPose(self.docked_x, self.docked_y, self.docked_yaw)


DEFAULTS = MappingProxyType(
    {
        "map_frame": "dock",
        "publish_tf": False,
        # Never relocate: a dock does not move, so detections that contradict the estimate are outliers or another dock.
        "relocation_fixes": 1_000_000,
        # The last part of an approach uses odometry alone, so the errors of the wheels matter.
        "wheels_as_configured": 0.0,
        "wheel_radius_sigma": 0.02,
    }
)
"""Defaults that differ from the defaults of an ekf in map."""
DockEkfConfig = variant(EkfNodeConfig, {"dock": DockDetection}, values=DEFAULTS)
"""Parameters of the node ``dock_ekf``."""
