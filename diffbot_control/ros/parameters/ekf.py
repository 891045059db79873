"""Parameters of the node ``ekf``, named as in robot_localization where that fits."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from diffbot_control.filter.landmark_map import LandmarkMap
from diffbot_control.filter.localization_config import LocalizationConfig
from diffbot_control.ros.frames import PREFIX_TEXT, RELIABLE_TEXT
from diffbot_control.ros.parameters.dock import DockDetection
from diffbot_core.errors import InvalidValueError
from diffbot_core.kinematics import WheelGeometry
from diffbot_core.ranges import TIMEOUT
from diffbot_core.ros.fault_parameters import FaultConfig
from diffbot_core.ros.lifecycle_parameters import LifecycleConfig
from diffbot_core.schema import Spec

_MIN_SIGMA, _MAX_SIGMA = 1e-4, 1e3
"""Standard deviations [m], [rad] that a filter can compute with."""


_TOPICS = ("global_pose", "heading", "imu", "landmarks", "initialpose", "odom", "joint_states", "detected_dock_pose")
"""Inputs whose topics are fixed."""


class SensorNoise(NamedTuple):
    """Standard deviations that are used for messages without a usable covariance; all zero means unknown."""

    global_pose_sigma_xy: Annotated[
        float,
        Spec(
            "deviation of x and y of global_pose without a usable covariance; 0: drop it",
            "m",
            minimum=0.0,
            maximum=_MAX_SIGMA,
        ),
    ] = 0.0
    global_pose_sigma_yaw: Annotated[
        float,
        Spec(
            "deviation of the heading of global_pose without a usable covariance; 0: drop it",
            "rad",
            minimum=0.0,
            maximum=_MAX_SIGMA,
        ),
    ] = 0.0
    heading_sigma: Annotated[
        float,
        Spec("deviation of heading without a usable covariance; 0: drop it", "rad", minimum=0.0, maximum=_MAX_SIGMA),
    ] = 0.0
    gyro_sigma: Annotated[
        float,
        Spec(
            "deviation of the turn rate of imu without a usable covariance; 0: drop it",
            "rad/s",
            minimum=0.0,
            maximum=_MAX_SIGMA,
        ),
    ] = 0.01
    landmark_range_sigma: Annotated[
        float, Spec("deviation of a range to a landmark without variances", "m", minimum=_MIN_SIGMA, maximum=_MAX_SIGMA)
    ] = 0.06
    landmark_range_sigma_per_metre: Annotated[
        float, Spec("by what landmark_range_sigma grows with the range", "m/m", minimum=0.0, maximum=1.0)
    ] = 0.0
    landmark_bearing_sigma: Annotated[
        float,
        Spec("deviation of a bearing to a landmark without variances", "rad", minimum=_MIN_SIGMA, maximum=_MAX_SIGMA),
    ] = 0.03
    override_covariance: Annotated[
        bool, Spec("the deviations set by parameters, where not 0, replace the covariances of messages")
    ] = False

    def check(self) -> None:
        """Refuse standard deviations that a filter cannot compute with.

        Raises:
            InvalidValueError: if one is neither 0 nor at least 1e-4.
        """
        for name in ("global_pose_sigma_xy", "global_pose_sigma_yaw", "heading_sigma", "gyro_sigma"):
            if 0.0 < getattr(self, name) < _MIN_SIGMA:
                raise InvalidValueError(name, getattr(self, name), f"0 or >= {_MIN_SIGMA:g}")


class EkfNodeConfig(NamedTuple):
    """Parameters of the node ``ekf``."""

    localization: LocalizationConfig = LocalizationConfig()
    wheels: WheelGeometry = WheelGeometry()
    odometry_source: Annotated[
        str, Spec("what predicts the motion", choices=("odom", "joint_states"), read_only=True)
    ] = "odom"
    wheel_noise: Annotated[
        float,
        Spec(
            "bound of the relative error of each wheel speed, independent from message to message, for joint_states",
            minimum=0.0,
            maximum=1.0,
        ),
    ] = 0.05
    noise: SensorNoise = SensorNoise()
    landmarks: LandmarkMap = LandmarkMap()
    dock: DockDetection = DockDetection()
    state_file: Annotated[
        str,
        Spec(
            "file that keeps pose and wheel errors across a restart, relative to the working folder; empty: none",
            read_only=True,
        ),
    ] = ""
    left_wheel_name: Annotated[str, Spec("joint of the left wheel", read_only=True)] = "left_wheel_joint"
    right_wheel_name: Annotated[str, Spec("joint of the right wheel", read_only=True)] = "right_wheel_joint"
    sensor_timeout: Annotated[
        float,
        Spec(
            "time without odometry that is reported as silence; after a longer gap its twist counts for this time only",
            "s",
            *TIMEOUT,
        ),
    ] = 1.0
    map_frame: Annotated[str, Spec("frame of fixes and estimates", read_only=True)] = "map"
    odom_frame: Annotated[str, Spec("frame of the odometry", read_only=True)] = "odom"
    base_link_frame: Annotated[str, Spec("frame of the robot", read_only=True)] = "base_link"
    frame_prefix: Annotated[str, Spec(PREFIX_TEXT, read_only=True)] = ""
    publish_tf: Annotated[bool, Spec("publish map -> odom", read_only=True)] = True
    transform_tolerance: Annotated[
        float,
        Spec(
            "time by which map -> odom is stamped into the future, so that it is valid for that long",
            "s",
            minimum=0.0,
            maximum=60.0,
            read_only=True,
        ),
    ] = 0.0
    reliable_inputs: Annotated[bool, Spec(RELIABLE_TEXT, read_only=True)] = False
    lifecycle: LifecycleConfig = LifecycleConfig()
    faults: FaultConfig = FaultConfig()

    def check(self) -> None:
        """Refuse two inputs on one topic.

        Raises:
            InvalidValueError: if a further source of fixes has the topic of another input.
        """
        topics = self.localization.sources.pose_sources
        if twice := sorted(set(_TOPICS).intersection(topics)):
            raise InvalidValueError("pose_sources", list(topics), f"topics of no other input, not {twice[0]}")
