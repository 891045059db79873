"""Parameters of the nodes ``controller`` and ``ekf``, named as in robot_localization and Nav2 where that fits."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from diffbot_control.config import Spec
from diffbot_control.kinematics import WheelGeometry
from diffbot_control.localization import LocalizationConfig
from diffbot_control.presets import PRESETS, TUNED
from diffbot_control.supervisor import SupervisorConfig


class ControllerNodeConfig(NamedTuple):
    """Parameters of the node ``controller``."""

    preset: Annotated[str, Spec("where the other defaults come from", choices=tuple(PRESETS), read_only=True)] = TUNED
    supervisor: SupervisorConfig = SupervisorConfig()
    pose_source: Annotated[
        str,
        Spec(
            "where the robot's pose comes from: the topic pose or the topic odometry/filtered",
            choices=("pose", "odometry"),
            read_only=True,
        ),
    ] = "pose"
    map_frame: Annotated[str, Spec("frame of poses and goals", read_only=True)] = "map"
    base_link_frame: Annotated[
        str, Spec("frame of the stamped command; child frame of odometry/filtered", read_only=True)
    ] = "base_link"
    enable_stamped_cmd_vel: Annotated[bool, Spec("publish TwistStamped instead of Twist", read_only=True)] = False


CONTROLLER_PRESETS = {
    name: ControllerNodeConfig(preset=name, supervisor=SupervisorConfig(controller=controller))
    for name, controller in PRESETS.items()
}
"""What the parameter ``preset`` chooses between."""


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
            "bound of the relative wheel-speed error, where the odometry tells no covariance",
            minimum=0.0,
            maximum=1.0,
        ),
    ] = 0.05
    left_wheel_name: Annotated[str, Spec("joint of the left wheel", read_only=True)] = "left_wheel_joint"
    right_wheel_name: Annotated[str, Spec("joint of the right wheel", read_only=True)] = "right_wheel_joint"
    sensor_timeout: Annotated[float, Spec("silence of the odometry that is reported", "s", minimum=0.0, above=True)] = (
        1.0
    )
    map_frame: Annotated[str, Spec("frame of fixes and estimates", read_only=True)] = "map"
    odom_frame: Annotated[str, Spec("frame of the odometry", read_only=True)] = "odom"
    base_link_frame: Annotated[str, Spec("frame of the robot", read_only=True)] = "base_link"
    publish_tf: Annotated[bool, Spec("publish map -> odom", read_only=True)] = True
