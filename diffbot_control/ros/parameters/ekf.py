"""Parameters of the node ``ekf``; parameters that also exist in robot_localization have the same names."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from diffbot_control.filter.config import MAX_SIGMA, MIN_SIGMA, LandmarkMap, LocalizationConfig
from diffbot_core.errors import InvalidValueError
from diffbot_core.kinematics import WheelGeometry
from diffbot_core.schema import TIMEOUT, Spec
from diffbot_core.shared_parameters import PREFIX_TEXT, RELIABLE_TEXT, FaultConfig, LifecycleConfig

_INPUTS = ("global_pose", "heading", "imu", "landmarks", "initialpose", "odom", "joint_states", "detected_dock_pose")
_OUTPUTS = ("pose", "odometry/filtered")
"""Inputs and outputs with fixed topics."""


class SensorNoise(NamedTuple):
    """Standard deviations for messages without a usable covariance; 0 means unknown."""

    global_pose_sigma_xy: Annotated[
        float,
        Spec(
            "deviation of x and y of global_pose without a usable covariance; 0: drop the message",
            "m",
            minimum=0.0,
            maximum=MAX_SIGMA,
        ),
    ] = 0.0
    global_pose_sigma_yaw: Annotated[
        float,
        Spec(
            "deviation of the heading of global_pose without a usable covariance; 0: drop the message",
            "rad",
            minimum=0.0,
            maximum=MAX_SIGMA,
        ),
    ] = 0.0
    heading_sigma: Annotated[
        float,
        Spec(
            "deviation of heading without a usable covariance; 0: drop the message",
            "rad",
            minimum=0.0,
            maximum=MAX_SIGMA,
        ),
    ] = 0.0
    gyro_sigma: Annotated[
        float,
        Spec(
            "deviation of the turn rate of imu without a usable covariance; 0: drop the message",
            "rad/s",
            minimum=0.0,
            maximum=MAX_SIGMA,
        ),
    ] = 0.01
    landmark_range_sigma: Annotated[
        float, Spec("deviation of a range to a landmark without variances", "m", minimum=MIN_SIGMA, maximum=MAX_SIGMA)
    ] = 0.06
    landmark_bearing_sigma: Annotated[
        float,
        Spec("deviation of a bearing to a landmark without variances", "rad", minimum=MIN_SIGMA, maximum=MAX_SIGMA),
    ] = 0.03
    override_covariance: Annotated[
        bool, Spec("true: use the deviations of the parameters that are not 0 instead of the covariances of messages")
    ] = False

    def check(self) -> None:
        """Check the standard deviations.

        Raises:
            InvalidValueError: if a deviation is neither 0 nor at least 1e-4, below which the filter is inaccurate.
        """
        for name in ("global_pose_sigma_xy", "global_pose_sigma_yaw", "heading_sigma", "gyro_sigma"):
            if 0.0 < getattr(self, name) < MIN_SIGMA:
                raise InvalidValueError(name, getattr(self, name), f"0 or >= {MIN_SIGMA:g}")


class NoDock(NamedTuple):
    """Placeholder for the parameters of a dock, which only ``dock_ekf`` has."""


class EkfNodeConfig(NamedTuple):
    """Parameters of the node ``ekf``."""

    localization: LocalizationConfig = LocalizationConfig()
    wheels: WheelGeometry = WheelGeometry()
    odometry_source: Annotated[
        str, Spec("topic of the odometry, which predicts the motion", choices=("odom", "joint_states"), read_only=True)
    ] = "odom"
    noise: SensorNoise = SensorNoise()
    landmarks: LandmarkMap = LandmarkMap()
    dock: NoDock = NoDock()
    state_file: Annotated[
        str,
        Spec(
            "file in which pose and estimated errors are saved, to restore them after a restart; relative to the "
            "working folder; empty: do not save",
            read_only=True,
        ),
    ] = ""
    left_wheel_name: Annotated[str, Spec("joint of the left wheel", read_only=True)] = "left_wheel_joint"
    right_wheel_name: Annotated[str, Spec("joint of the right wheel", read_only=True)] = "right_wheel_joint"
    sensor_timeout: Annotated[
        float,
        Spec(
            "time after which the node reports missing odometry; after a longer gap, the twist moves the estimate for "
            "this time only",
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
            "time by which map -> odom is stamped into the future, and for which it is therefore valid",
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
        """Check that no topic in ``pose_sources`` is another topic of the node.

        Raises:
            InvalidValueError: if one of ``pose_sources`` is the topic of another input or of an output.
        """
        topics = self.localization.sources.pose_sources
        if twice := sorted({*_INPUTS, *_OUTPUTS}.intersection(topics)):
            raise InvalidValueError(
                "pose_sources", list(topics), sentence=f"{twice[0]} is already another topic of the node"
            )
