"""Parameters of the node ``ekf`` for a dock that is detected: its filter is in the frame of the dock."""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from diffbot_control.filter.dock import Mounting
from diffbot_core.geometry import Pose
from diffbot_core.ranges import HEADING, POSITION
from diffbot_core.schema import Spec

NO_DOCK, POSE, POSE_WITH_COVARIANCE = "none", "pose", "pose_with_covariance"


class DockDetection(NamedTuple):
    """What detects the dock, where it is on the robot, and how well it measures."""

    dock_detection: Annotated[
        str,
        Spec(
            "type of detected_dock_pose: PoseStamped or PoseWithCovarianceStamped; the poses of the filter are then in "
            "the dock's frame, whose origin is the docked robot",
            choices=(NO_DOCK, POSE, POSE_WITH_COVARIANCE),
            read_only=True,
        ),
    ] = NO_DOCK
    detector_frame: Annotated[str, Spec("frame of the detections; empty: base_link_frame", read_only=True)] = ""
    detector_x: Annotated[float, Spec("x of that frame on the robot", "m", *POSITION)] = 0.0
    detector_y: Annotated[float, Spec("y of that frame on the robot", "m", *POSITION)] = 0.0
    detector_yaw: Annotated[float, Spec("heading of that frame on the robot", "rad", *HEADING)] = 0.0
    docked_x: Annotated[float, Spec("x of the docked robot in the frame of what is detected", "m", *POSITION)] = 0.0
    docked_y: Annotated[float, Spec("y of the docked robot there", "m", *POSITION)] = 0.0
    docked_yaw: Annotated[float, Spec("heading of the docked robot there", "rad", *HEADING)] = 0.0
    dock_sigma: Annotated[
        float, Spec("deviation of x and of y of a detection without covariance, at the dock", "m", 1e-4, 10.0)
    ] = 0.01
    dock_sigma_per_metre: Annotated[float, Spec("what a metre of distance adds to it", "m/m", 0.0, 1.0)] = 0.01
    dock_yaw_sigma: Annotated[float, Spec("deviation of its heading at the dock", "rad", 1e-4, math.pi)] = 0.02
    dock_yaw_sigma_per_metre: Annotated[float, Spec("what a metre of distance adds to it", "rad/m", 0.0, 1.0)] = 0.01

    def mounting(self) -> Mounting:
        """Return where the detector and the docked robot are."""
        return Mounting(
            Pose(self.detector_x, self.detector_y, self.detector_yaw),
            Pose(self.docked_x, self.docked_y, self.docked_yaw),
        )
